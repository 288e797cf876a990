"""Wrenches of contacts: the edges of their friction cones as forces and torques on the object.

Convention: each edge of a contact's friction cone has a unit *normal* component. Torques are taken about the centre of
mass and divided by a characteristic length, the distance of the farthest surface point from it, which makes whatever is
computed from wrenches independent of the object's size.
"""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.compiled import njit


@njit(cache=True, error_model="numpy")
def fill_grasp_wrenches(points, normals, count, com, friction, edges, torsion, length, out):  # type: ignore[no-untyped-def]
    """Write the wrenches of the first `count` contacts to `out`; returns how many rows were written.

    Allocation-free kernel behind `grasp_wrenches`; `out` needs count * (edges + 2) rows.
    """
    cx = cy = cz = 0.0
    for i in range(count):
        cx += (points[i, 0] - com[0]) / count
        cy += (points[i, 1] - com[1]) / count
        cz += (points[i, 2] - com[2]) / count
    row = 0
    for i in range(count):
        # the force on the object points inward
        nx, ny, nz = -normals[i, 0], -normals[i, 1], -normals[i, 2]
        rx, ry, rz = points[i, 0] - com[0], points[i, 1] - com[1], points[i, 2] - com[2]
        # the first tangent follows the grasp, not the frame, so that epsilon does not change with the frame
        ax, ay, az = rx, ry, rz
        for attempt in range(4):
            if attempt == 1:
                ax, ay, az = cx, cy, cz
            elif attempt == 2:
                ax, ay, az = 1.0, 0.0, 0.0
            elif attempt == 3:
                ax, ay, az = 0.0, 1.0, 0.0
            along = ax * nx + ay * ny + az * nz
            ux, uy, uz = ax - along * nx, ay - along * ny, az - along * nz
            size = math.sqrt(ux * ux + uy * uy + uz * uz)
            if size > (1e-6 * length if attempt < 2 else 0.5):
                break
        ux, uy, uz = ux / size, uy / size, uz / size
        vx, vy, vz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        for k in range(edges):
            angle = 2.0 * math.pi * k / edges
            c, s = friction * math.cos(angle), friction * math.sin(angle)
            fx, fy, fz = nx + c * ux + s * vx, ny + c * uy + s * vy, nz + c * uz + s * vz
            out[row, 0], out[row, 1], out[row, 2] = fx, fy, fz
            out[row, 3] = (ry * fz - rz * fy) / length
            out[row, 4] = (rz * fx - rx * fz) / length
            out[row, 5] = (rx * fy - ry * fx) / length
            row += 1
        if torsion > 0.0:
            tx, ty, tz = (ry * nz - rz * ny) / length, (rz * nx - rx * nz) / length, (rx * ny - ry * nx) / length
            spin = torsion / length
            for sign in (-1.0, 1.0):
                out[row, 0], out[row, 1], out[row, 2] = nx, ny, nz
                out[row, 3] = tx + sign * spin * nx
                out[row, 4] = ty + sign * spin * ny
                out[row, 5] = tz + sign * spin * nz
                row += 1
    return row


@njit(cache=True, error_model="numpy")
def grasp_wrenches(points, normals, com, friction, edges=8, torsion=0.0, length=1.0):  # type: ignore[no-untyped-def]
    """Wrenches on the object of every friction-cone edge, callable from numba and from Python.

    Each edge is f = -n + friction (cos a u + sin a v), torque (p - com) x f / length. With `torsion` > 0 each contact
    is a soft finger: two more wrenches, the unit normal force with +-torsion of pure torque about the normal, are
    added, so that friction and torsion share the limit |f_t| / friction + |m| / torsion <= f_n (the polyhedral inner
    bound of the elliptic limit surface).

    Args:
        points: (C, 3) float64 contacts, object frame, metres; normals: (C, 3) unit, outward from the object.
        com: (3,) centre of mass, metres.
        friction: Coulomb coefficient, > 0 (0 = frictionless).
        edges: edges of the linearised cone.
        torsion: torsional friction coefficient, metres (torque per normal force, as in MuJoCo); 0 = hard finger.
        length: characteristic length, metres: see `characteristic_length`.
    Returns:
        (C * edges, 6) float64 [force, torque / length], or (C * (edges + 2), 6) with torsion.
    """
    count = len(points)
    out = np.empty((count * (edges + (2 if torsion > 0.0 else 0)), 6))
    fill_grasp_wrenches(points, normals, count, com, friction, edges, torsion, length, out)
    return out


def characteristic_length(points_O: np.ndarray, com_O: np.ndarray) -> float:
    """Distance in metres of the farthest surface point (P, 3) from the centre of mass (3,)."""
    return float(np.sqrt(((np.asarray(points_O) - com_O) ** 2).sum(axis=1).max()))
