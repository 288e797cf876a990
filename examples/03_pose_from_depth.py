"""Find an object's pose in one depth image: python examples/03_pose_from_depth.py [picture.png].

Here the image is simulated, with a sensor's noise and things in front of the object. With a real camera, make the frame
with `perception.frame_files.read_frame` (or `Frame(depth_m, intrinsics)`) and keep the rest.
"""

import sys

import numpy as np

import neuralgrasps as ng
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.evaluate.pose_scenes import pose_scene
from neuralgrasps.perception.find import find_objects
from neuralgrasps.perception.table import find_table
from neuralgrasps.report.figures import save_picture
from neuralgrasps.report.pose_overlay import DrawnModel, render_pose_overlay

models = [ng.load_object(name) for name in ("mustard_bottle", "cracker_box", "gelatin_box")]
obj = models[0]
scene = pose_scene(obj, "occluded", seed=4, distractors=models)
frame, table = scene.frame, find_table(scene.frame).plane

# the object's pixels are known, from a segmentation for example
result = ng.estimate_pose(obj, depth=frame.depth, intrinsics=frame.intrinsics, mask=scene.mask, table=table)
errors = pose_errors(obj, result.X_CO, scene.X_CO_true)
print(f"{scene.visible_share:.0%} of the object is visible; the pose is right with {result.confidence:.0%} confidence")
print(
    f"rotation {np.rad2deg(errors.rotation_rad):.2f} deg, translation {errors.translation_m * 1e3:.2f} mm off "
    f"(modulo {len(obj.symmetry)} symmetries); other poses that fit: {len(result.alternatives_X_CO) - 1}"
)

# nothing is known but the models: what stands on the table, and where?
for found in find_objects(models, frame, table=table):
    x, y, z = found.pose.X_CO[:3, 3]
    print(f"{found.name}: {found.probability * found.pose.confidence:.0%} sure, at ({x:.3f}, {y:.3f}, {z:.3f}) m")

if sys.argv[1:]:
    drawn = DrawnModel(mesh=obj.mesh, X_CO=result.X_CO, label=obj.name)
    save_picture(sys.argv[1], render_pose_overlay(frame.depth, [drawn], frame.intrinsics))
