"""Find an object's pose in one depth image: python examples/03_pose_from_depth.py.

Here the image is simulated; with a real camera, fill `depth` (metres) and `intrinsics` and keep the rest.
"""

import numpy as np

import neuralgrasps as ng
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import back_project, look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.table import find_table
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

obj = ng.load_object("mustard_bottle")
intrinsics = ng.Intrinsics.from_fov(np.deg2rad(45.0), 320, 240)
X_WC = look_at(np.array([0.5, -0.3, 0.5]), np.array([0.0, 0.0, 0.05]))

# the scene: the object in its most probable resting pose on a table whose top is at z = 0
X_WO = resting_poses(obj.mesh.vertices, obj.com_O)[0][0]
X_WT = np.eye(4)
X_WT[2, 3] = -0.01
view = render_depth_view(
    [obj.mesh, box_mesh([0.5, 0.5, 0.01])], np.stack([X_WO, X_WT]), X_WC=X_WC, intrinsics=intrinsics, noise=DepthNoise()
)

frame = Frame(view.depth, intrinsics)
mask = find_clusters(frame, find_table(frame).plane)[0]
points_C = back_project(view.depth, intrinsics, mask=mask)
result = ng.estimate_pose(obj, points_C, depth=view.depth, intrinsics=intrinsics)
errors = pose_errors(obj, result.X_CO, np.linalg.inv(X_WC) @ X_WO)
print(f"found: {result.converged}, {len(points_C)} points, {len(result.alternatives_X_CO)} poses compared")
print(
    f"rotation {np.rad2deg(errors.rotation_rad):.2f} deg, translation {errors.translation_m * 1e3:.2f} mm off "
    f"(modulo {len(obj.symmetry)} symmetries)"
)
