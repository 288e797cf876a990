"""Find objects' poses in one depth image: python examples/03_pose_from_depth.py [picture.png].

Here the image is simulated, with a sensor's noise, so that the truth is known. With a real camera, read the frame with
`ng.read_frame("depth.png", colour="color.png", intrinsics=..., depth_scale=...)` and keep the rest.
"""

import sys

import numpy as np

import neuralgrasps as ng
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.evaluate.pose_occluders import turn_z
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.perception.find import find_objects
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.table import find_table
from neuralgrasps.report.figures import save_picture
from neuralgrasps.report.pose_overlay import DrawnModel, model_colour, render_pose_overlay
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

models = {name: ng.load_object(name) for name in ("mustard_bottle", "cracker_box", "gelatin_box")}

# three objects on a table, simulated: where they stand, and what the camera measures of them
X_WC = look_at(np.array([0.6, 0.1, 0.5]), np.array([0.0, 0.0, 0.04]))
X_WO = {name: resting_poses(obj.mesh.vertices, obj.com_O)[0][0] for name, obj in models.items()}
for name, (x, y, turn) in zip(models, ((0.0, -0.08, 0.7), (-0.1, 0.1, 2.0), (0.1, 0.06, 4.0)), strict=True):
    X_WO[name] = turn_z(turn) @ X_WO[name]
    X_WO[name][:2, 3] += x, y
X_WT = np.eye(4)
X_WT[2, 3] = -0.01
camera = Intrinsics(600, 600, 319.5, 239.5, 640, 480)
meshes = [*(obj.mesh for obj in models.values()), box_mesh([0.5, 0.5, 0.01])]
view = render_depth_view(
    meshes, np.stack([*X_WO.values(), X_WT]), X_WC=X_WC, intrinsics=camera, noise=STRUCTURED_LIGHT, seed=4
)
frame = Frame(depth=view.depth, intrinsics=camera, X_WC=X_WC)
table = find_table(frame).plane


def report(name: str, X_CO: np.ndarray, confidence: float) -> None:
    """Print a pose beside the true one."""
    X_CO_true = np.linalg.inv(X_WC) @ X_WO[name]
    errors = pose_errors(models[name], X_CO, X_CO_true)
    found, true = (", ".join(f"{v:+.3f}" for v in X[:3, 3]) for X in (X_CO, X_CO_true))
    print(
        f"  {name}: {confidence:.0%} sure, at ({found}) m; simulated truth ({true}) m: "
        f"{errors.translation_m * 1e3:.1f} mm and {np.rad2deg(errors.rotation_rad):.1f} deg off"
    )


print("simulated frame; one object, whose pixels are known, from a segmentation for example:")
mask = (view.mesh_index == 0) & (frame.depth > 0)
result = ng.estimate_pose(models["mustard_bottle"], depth=frame.depth, intrinsics=camera, mask=mask, table=table)
report("mustard_bottle", result.X_CO, result.confidence)

print("nothing is known but the models: what stands on the table, and where?")
drawn: list[DrawnModel] = []
for found in find_objects(list(models.values()), frame, table=table):
    report(found.name, found.pose.X_CO, min(found.probability, found.pose.confidence))
    colour = model_colour(len(drawn))
    drawn.append(DrawnModel(mesh=models[found.name].mesh, X_CO=found.pose.X_CO, label=found.name, colour=colour))

if sys.argv[1:]:
    save_picture(sys.argv[1], render_pose_overlay(frame.depth, drawn, camera))
