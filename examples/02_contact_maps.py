"""Compare grasps of different hands by where they touch: python examples/02_contact_maps.py.

The contact map gives every surface point a closeness to the hand, 1 where it touches. Maps of different hands live on
the same object points, so they can be compared directly. This is what the latent space is built on.
"""

import numpy as np

import neuralgrasps as ng

obj = ng.load_object("tomato_soup_can")
config = ng.SynthesisConfig(count=12)
maps, owners = [], []
for name in ("human", "fetch", "barrett"):
    hand = ng.load_hand(name)
    grasps = ng.synthesise(hand, obj, config=config, seed=0).grasps
    maps.append(ng.contact_map(obj.points_O, hand, grasps.X_OH, grasps.q, radius=0.02))
    owners += [(name, i) for i in range(len(grasps))]

stacked = np.concatenate(maps)
distance = np.abs(stacked[:, None] - stacked[None]).mean(axis=-1)
for name in ("fetch", "barrett"):
    rows = [k for k, (owner, _) in enumerate(owners) if owner == name]
    nearest = rows[int(distance[0, rows].argmin())]
    print(f"human grasp 0 is most like {name} grasp {owners[nearest][1]} (mean difference {distance[0, nearest]:.3f})")
