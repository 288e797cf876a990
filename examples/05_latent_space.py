"""What the latent space can do with the run that comes with the library: python examples/05_latent_space.py.

Which Fetch grasps touch the bottle like this human one does? Where is a hand of which one camera saw some points? And
what lies between two known grasps? Needs no training; the last question ends in a physics simulation.
"""

import numpy as np

import neuralgrasps as ng


def main() -> None:
    run = ng.load_run("standins7")
    field, book, name = run.field, run.codebook, "mustard_bottle"

    known = book[book.where(hand="human", object_name=name, is_test=True)][0]
    found = ng.retrieve(known, book, object_name=name, hand="fetch", count=3)
    rows = book.grasp_index[found.index[0]]
    print(
        f"Fetch grasps {rows} touch it most like human grasp {known.grasp_index[0]}: {found.map_distance[0].round(3)}"
    )

    truth = run.grasps["human", name][known.grasp_index]
    cloud_O = ng.observe_hand(field.packed["human"], truth.X_OH[0], truth.q[0], seed=0, noise_m=0.003)
    seen = ng.infer_grasps([cloud_O], field, book[book.where(is_test=False)], hand="human", object_name=name)
    off_mm = 1e3 * np.linalg.norm(seen.X_OH[0, :3, 3] - truth.X_OH[0, :3, 3])
    print(
        f"from 1,024 points with 3 mm noise the hand is found {off_mm:.1f} mm off; doubts: {seen.reasons[0] or 'none'}"
    )

    new = ng.novel_grasps(
        field, book, hand="allegro", object_name=name, config=ng.NovelConfig(kind="midpoint", count=8)
    )
    print(f"{len(new.grasps)} of 8 Allegro grasps halfway between known ones hold: {dict(new.counts)}")
    ng.save_grasps("novel_allegro.safetensors", new.grasps)


if __name__ == "__main__":  # worker processes import this file
    main()
