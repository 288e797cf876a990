"""A robot looks at its table, finds an object, plans and lifts it, in simulation; then the same on what it only plans.

python examples/07_pick_up.py                       Fetch, mustard bottle
python examples/07_pick_up.py panda allegro potted_meat_can
python examples/07_pick_up.py my_arm.urdf my_hand.urdf my_part.stl

The first run makes and proves grasps for the way the object lies: some seconds; later ones find them again.
"""

from __future__ import annotations

import sys

import numpy as np

import neuralgrasps as ng


def main(arm: str = "fetch", hand: str = "fetch", object_name: str = "mustard_bottle") -> None:
    obj = ng.load_object(object_name)
    manipulator = ng.mount(ng.load_arm(arm), ng.load_hand(hand))
    scene = ng.draw_scene([obj], manipulator.arm, seed=3)  # a table in reach, the object at rest on it, somewhere
    robot = ng.SimulatedRobot(manipulator, scene, seed=0)
    robot.settle()

    proposal = ng.propose_pick(robot, obj)  # look, find the table and the object, plan; nothing moves
    if proposal.plan is None:
        print("no plan:", proposal.reason)
        return
    plan = proposal.plan
    off = proposal.X_BO[:3, 3] - robot.object_pose(0)[:3, 3]
    print(f"found the object {1e3 * np.linalg.norm(off):.1f} mm from where the simulator has it")
    print(f"planned in {1e3 * proposal.result.cpu_s:.0f} ms of processor time; {proposal.result.tried} grasps tried")
    print(f"transfer {plan.transfer.duration_s:.1f} s, approach {plan.approach.duration_s:.1f} s")

    before = robot.object_pose(0)[2, 3]
    ng.carry_out(robot, plan)  # the same call drives any Robot: see docs/robots.md
    print(f"lifted by {1e3 * (robot.object_pose(0)[2, 3] - before):.0f} mm, and held for 2 s")


if __name__ == "__main__":
    main(*sys.argv[1:])
