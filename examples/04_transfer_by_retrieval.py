"""The nearest grasps of other hands, for a grasp seen only as points: python examples/04_transfer_by_retrieval.py.

Makes grasps of three hands, a data set and a field in ./transfer_example (again in seconds when it is there), then
asks: a human hand was seen holding the can, as unlabelled surface points. Which Fetch and Allegro grasps touch it the
same way?
"""

from pathlib import Path

import neuralgrasps as ng


def main() -> None:
    folder = Path("transfer_example")
    hands = {name: ng.load_hand(name) for name in ("human", "allegro", "fetch")}
    obj = ng.load_object("tomato_soup_can")
    sets, _ = ng.collect_grasps(
        folder / "grasps", list(hands.values()), [obj], config=ng.SynthesisConfig(count=24), seed=0
    )
    ng.build_dataset(folder / "dataset", sets, hands=hands, objects={obj.name: obj})
    dataset = ng.read_dataset(folder / "dataset")
    trained = ng.train(dataset, hands=hands, objects={obj.name: obj}, config=ng.TrainConfig(steps=100))
    ng.save_run(folder / "run", trained)

    query = int(dataset.split("human", obj.name).test[0])  # a grasp that training did not see
    grasp = dataset.grasps("human", obj.name)[query]
    field = trained.field
    seen_O = ng.observe_hand(field.packed["human"], grasp.X_OH[0], grasp.q[0], seed=0)
    code = ng.encode_points([seen_O], field, object_name=obj.name)
    for name in ("fetch", "allegro"):
        found = ng.retrieve(code, trained.codebook, object_name=obj.name, hand=name, count=3)
        rows = [int(trained.codebook.grasp_index[i]) for i in found.index[0]]
        off = found.map_distance[0].round(3)
        print(f"human grasp {query} is most like {name} grasps {rows}, contact maps off by {off}")


if __name__ == "__main__":  # worker processes import this file
    main()
