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
    rows, off = book.grasp_index[found.index[0]], found.map_distance[0].round(3)
    print(f"Fetch grasps {rows} touch it most like human grasp {known.grasp_index[0]}, contact maps off by {off}")

    truth = run.grasps["human", name][known.grasp_index]
    view = ng.view_hand(field.hand("human"), field.object(name), truth.X_OH[0], truth.q[0], seed=0, noise_m=0.003)
    seen = ng.infer_grasps(  # for a cloud of your own: points of the hand, metres, object frame
        [view.points_O], field, book, hand="human", object_name=name, viewpoints_O=[view.viewpoint_O]
    )
    off_mm = 1e3 * np.linalg.norm(seen.X_OH[0, :3, 3] - truth.X_OH[0, :3, 3])
    doubts = "; ".join(seen.reasons[0]) or "none"
    print(f"from one view with 3 mm noise the wrist is found {off_mm:.1f} mm off; doubts: {doubts}")

    config = ng.NovelConfig(kind="midpoint", count=8)
    new = ng.novel_grasps(field, book, hand="allegro", object_name=name, config=config)
    print(f"{len(new.grasps)} of 8 Allegro grasps halfway between known ones hold: {dict(new.counts)}")
    ng.save_grasps("novel_allegro.safetensors", new.grasps)


if __name__ == "__main__":  # worker processes import this file
    main()
