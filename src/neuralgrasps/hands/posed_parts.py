"""The parts of a posed hand: their frames, and the one nearest to a point, with its gradient; compiled. Torch-free.

For fits, which ask for many points at one pose. Points and results are in H, the hand's base frame, metres.
"""

from __future__ import annotations

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.shape_kernels import box_sdf, capsule_sdf
from neuralgrasps.hands.hand import PartKind
from neuralgrasps.hands.part_gradient import part_distance_gradient
from neuralgrasps.hands.parts import part_distance

_BOX, _CAPSULE = int(PartKind.BOX), int(PartKind.CAPSULE)


@njit(cache=True, error_model="numpy")
def part_poses_H(packed, X_HL, X_PH, centre_H):  # type: ignore[no-untyped-def]
    """X_PH (Np, 3, 4) and the centres (Np, 3) of the parts' spheres in H."""
    for part in range(packed.part_link.shape[0]):
        X = X_HL[packed.part_link[part]]
        P, c = packed.part_X_PL[part], packed.part_centre[part]
        centre_H[part, 0], centre_H[part, 1], centre_H[part, 2] = moved_point(X, c[0], c[1], c[2])
        for row in range(3):
            t = P[row, 3]
            for col in range(3):  # R_PH = R_PL R_HL^T, t_PH = t_PL - R_PH t_HL
                r = P[row, 0] * X[col, 0] + P[row, 1] * X[col, 1] + P[row, 2] * X[col, 2]
                X_PH[part, row, col] = r
                t -= r * X[col, 3]
            X_PH[part, row, 3] = t


@njit(cache=True, inline="always", error_model="numpy")
def _in_part(packed, X_PH, part, x, y, z):  # type: ignore[no-untyped-def]
    X, size = X_PH[part], packed.part_size[part]
    px, py, pz = moved_point(X, x, y, z)
    kind = packed.part_kind[part]
    if kind == _BOX:
        return box_sdf(px, py, pz, size[0], size[1], size[2])
    if kind == _CAPSULE:
        return capsule_sdf(px, py, pz, size[0], size[1])
    planes = packed.hull_planes[packed.hull_plane_start[part] : packed.hull_plane_start[part + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]
    return part_distance(kind, size, planes, triangles, px, py, pz)


@njit(cache=True, error_model="numpy")
def nearest_of_parts(packed, X_PH, centre_H, first, x, y, z):  # type: ignore[no-untyped-def]
    """(signed distance, part) of the part nearest to (x, y, z) in H; `first` is a guess, the better the faster."""
    best, found = _in_part(packed, X_PH, first, x, y, z), first
    for part in range(centre_H.shape[0]):
        dx, dy, dz = x - centre_H[part, 0], y - centre_H[part, 1], z - centre_H[part, 2]
        reach = best + packed.part_radius[part]  # the part is no nearer than its sphere
        if part == first or reach <= 0.0 or dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        d = _in_part(packed, X_PH, part, x, y, z)
        if d < best:
            best, found = d, part
    return best, found


@njit(cache=True, error_model="numpy")
def gradient_in_H(packed, X_PH, part, x, y, z):  # type: ignore[no-untyped-def]
    """Gradient (3) in H of the signed distance to one part at (x, y, z) in H."""
    X = X_PH[part]
    px, py, pz = moved_point(X, x, y, z)
    planes = packed.hull_planes[packed.hull_plane_start[part] : packed.hull_plane_start[part + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]
    gx, gy, gz = part_distance_gradient(packed.part_kind[part], packed.part_size[part], planes, triangles, px, py, pz)
    return (
        X[0, 0] * gx + X[1, 0] * gy + X[2, 0] * gz,
        X[0, 1] * gx + X[1, 1] * gy + X[2, 1] * gz,
        X[0, 2] * gx + X[1, 2] * gy + X[2, 2] * gz,
    )
