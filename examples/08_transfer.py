"""A human grasp of the mustard bottle for a Fetch and an Allegro, the cap left free: python examples/08_transfer.py.

Needs no training: the run that comes with the library has grasps of five hands. The answers are found by search around
those, each is tried in physics, and the hands stay off the cap, so that it can be opened.
"""

import neuralgrasps as ng
from neuralgrasps.apply.constraint_text import constraints_from_text


def main() -> None:
    run = ng.load_run("standins7")
    name = "mustard_bottle"
    human, obj = run.field.hand("human"), run.field.object(name)
    grasp = run.grasps["human", name][0]
    query = ng.query_from_grasp(human, obj, grasp.X_OH[0], grasp.q[0])

    free_cap = constraints_from_text(obj, keep_free=["top:0.25"], margin_m=0.01)
    for hand_name in ("fetch", "allegro"):
        hand, known = run.field.hand(hand_name), run.grasps[hand_name, name]
        result = ng.transfer(query, hand, obj, known=known, constraints=free_cap, seed=0)
        if not len(result.grasps):
            print(f"{hand_name}: {result.reason}; {free_cap.describe(hand, known.X_OH, known.q, known.q_pregrasp)}")
            continue
        clear = 1e3 * free_cap.clearance(hand, result.grasps.X_OH[:1], result.grasps.q[:1])[0]
        print(f"{hand_name}: {len(result.grasps)} grasps hold, the best {clear:.0f} mm off the cap")
        print(f"  {result.reasons[0]}")
        ng.save_grasps(f"transferred_{hand_name}.safetensors", result.grasps)


if __name__ == "__main__":  # worker processes import this file
    main()
