"""Grasp an object with a hand and prove it: python examples/01_grasps.py [HAND] [OBJECT].

HAND is a built-in name or a URDF or MJCF file, OBJECT a built-in name or a mesh file.
"""

import sys

import numpy as np

import neuralgrasps as ng

hand = ng.load_hand(sys.argv[1] if len(sys.argv) > 1 else "allegro")
obj = ng.load_object(sys.argv[2] if len(sys.argv) > 2 else "mustard_bottle")

result = ng.synthesise(hand, obj, config=ng.SynthesisConfig(count=12), seed=0)
grasps = result.grasps
print(f"{len(grasps)} grasps; {result.physics_success:.0%} of {result.tried} tried in physics held. {result.reason}")
if not len(grasps):
    sys.exit(1)

best = int(grasps.epsilon.argmax())
print(f"best epsilon {grasps.epsilon[best]:.3f}, {grasps.num_contacts[best]} contacts, palm at (object frame, m):")
print(np.round((grasps.X_OH[best] @ hand.X_HP)[:3, 3], 3))

hard = ng.validate_grasps(hand, obj, grasps, "dexgraspbench-hard")
print(f"{hard.success.mean():.0%} also hold at half the friction ({hard.parameters['friction']:.1f})")
ng.save_grasps("grasps.safetensors", grasps)
print("wrote grasps.safetensors")
