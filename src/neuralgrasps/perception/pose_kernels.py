"""Compiled parts of the pose search: fast scores of many poses, and Levenberg-Marquardt on SE(3) of one.

Poses are X_CO, twists [v, w] move the object in camera axes about a centre c: p -> p + v + w x (p - c).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.sdf_grid import grid_distance_gradient


class Terms(NamedTuple):
    """Weights and scales of the objective of one polish.

    Attributes:
        kernel_m: scale of the Geman-McClure loss of the observed points.
        free: weight of model points that stick out into free space, as a share of that of the points.
        table: weight of the table, as a share of that of the points; rest: of a stable pose on it.
        margin_m: how far in front of the measured depth noise may put a surface, at 1 m.
        points, model_points: how many observed and model points to use.
    """

    kernel_m: float
    free: float
    table: float
    rest: float
    margin_m: float
    points: int
    model_points: int


UNMEASURED = 0.1  # weight of pixels without a measurement: a weak hint only
FREE_HUBER_M = 0.010
TABLE_KERNEL_M = 0.020  # Geman-McClure: a table far from where the view puts the object has no say
REST_LIMIT = 0.25  # rad: farther from every stable pose, the object does not rest on the table
REST_KERNEL = 0.05  # rad
CONTACT_KERNEL_M = 0.006


@njit(cache=True, inline="always", error_model="numpy")
def _nearest(values, origin, inv_spacing, x, y, z):  # type: ignore[no-untyped-def]
    """Distance at the nearest node; outside the grid also the distance to it."""
    u, v, w = (x - origin[0]) * inv_spacing, (y - origin[1]) * inv_spacing, (z - origin[2]) * inv_spacing
    cu = min(max(u, 0.0), values.shape[0] - 1.0)
    cv = min(max(v, 0.0), values.shape[1] - 1.0)
    cw = min(max(w, 0.0), values.shape[2] - 1.0)
    d = values[np.int64(cu + 0.5), np.int64(cv + 0.5), np.int64(cw + 0.5)]
    return d + (abs(u - cu) + abs(v - cv) + abs(w - cw)) / inv_spacing


@njit(cache=True, inline="always", error_model="numpy")
def stick_out(depth, outside, camera, box, margin, x, y, z):  # type: ignore[no-untyped-def]
    """(metres, row, column): how far from the mask a model point lies that the camera sees past; 0 = nothing wrong."""
    if z <= 1.0e-3:
        return 0.0, 0, 0
    u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
    if u < box[0] or u > box[1] or v < box[2] or v > box[3]:
        return 0.0, 0, 0
    i = min(max(np.int64(v + 0.5), 0), depth.shape[0] - 1)
    j = min(max(np.int64(u + 0.5), 0), depth.shape[1] - 1)
    if outside[i, j] <= 1.0:
        return 0.0, 0, 0
    share = 1.0
    if depth[i, j] <= 0.0:
        share = UNMEASURED
    elif depth[i, j] < z + margin * (0.5 + z * z):
        return 0.0, 0, 0
    return share * (outside[i, j] - 1.0) * z / camera[0], i, j


@njit(cache=True, error_model="numpy")
def coarse_scores(model, scene, X_CO, point_count, model_count, clip, free, margin, out):  # type: ignore[no-untyped-def]
    """Cost (N,) of poses (N, 4, 4): mean clipped distance of the points plus that of model points in free space."""
    n_points = min(point_count, scene.points.shape[0])
    n_model = min(model_count, model.points.shape[0])
    for n in range(X_CO.shape[0]):
        X = X_CO[n]
        total = 0.0
        for m in range(n_points):
            a, b, c = scene.points[m, 0] - X[0, 3], scene.points[m, 1] - X[1, 3], scene.points[m, 2] - X[2, 3]
            x = X[0, 0] * a + X[1, 0] * b + X[2, 0] * c
            y = X[0, 1] * a + X[1, 1] * b + X[2, 1] * c
            z = X[0, 2] * a + X[1, 2] * b + X[2, 2] * c
            total += min(abs(_nearest(model.coarse, model.origin, model.coarse_inv_spacing, x, y, z)), clip)
        out[n] = total / n_points
        total = 0.0
        facing = 0
        for m in range(n_model):
            x, y, z, towards = _posed(model, X, m)
            if towards >= 0.0:
                continue
            facing += 1
            total += min(stick_out(scene.depth, scene.outside, scene.camera, scene.image_box, margin, x, y, z)[0], clip)
        out[n] += free * total / max(facing, 1)


@njit(cache=True, inline="always", error_model="numpy")
def _posed(model, X, m):  # type: ignore[no-untyped-def]
    """Surface point m in the camera frame, and its normal times the ray to it: negative when it faces the camera."""
    px, py, pz = model.points[m, 0], model.points[m, 1], model.points[m, 2]
    nx, ny, nz = model.normals[m, 0], model.normals[m, 1], model.normals[m, 2]
    x = X[0, 0] * px + X[0, 1] * py + X[0, 2] * pz + X[0, 3]
    y = X[1, 0] * px + X[1, 1] * py + X[1, 2] * pz + X[1, 3]
    z = X[2, 0] * px + X[2, 1] * py + X[2, 2] * pz + X[2, 3]
    towards = (
        (X[0, 0] * nx + X[0, 1] * ny + X[0, 2] * nz) * x
        + (X[1, 0] * nx + X[1, 1] * ny + X[1, 2] * nz) * y
        + (X[2, 0] * nx + X[2, 1] * ny + X[2, 2] * nz) * z
    )
    return x, y, z, towards


@njit(cache=True, error_model="numpy")
def slide(model, scene, X_CO, point_count, steps):  # type: ignore[no-untyped-def]
    """Gauss-Newton on the translation of every pose (N, 4, 4), in place; residuals beyond 4 cm are ignored."""
    n_points = min(point_count, scene.points.shape[0])
    for n in range(X_CO.shape[0]):
        X = X_CO[n]
        for _ in range(steps):
            H = np.zeros((3, 3))
            b = np.zeros(3)
            for m in range(n_points):
                d, gx, gy, gz, _, _, _ = _point_residual(model, scene, X, m)
                if abs(d) > 0.04:
                    continue
                g = (gx, gy, gz)
                for r in range(3):
                    b[r] += g[r] * d
                    for c in range(3):
                        H[r, c] += g[r] * g[c]
            for r in range(3):
                H[r, r] += 1.0e-2 * n_points
            step = np.linalg.solve(H, b)
            for r in range(3):
                X[r, 3] += step[r]


@njit(cache=True, inline="always", error_model="numpy")
def _point_residual(model, scene, X, m):  # type: ignore[no-untyped-def]
    """(signed distance, its gradient in camera axes, the point) of observed point m."""
    px, py, pz = scene.points[m, 0], scene.points[m, 1], scene.points[m, 2]
    a, b, c = px - X[0, 3], py - X[1, 3], pz - X[2, 3]
    d, gx, gy, gz = grid_distance_gradient(
        model.values, model.origin, model.inv_spacing,
        X[0, 0] * a + X[1, 0] * b + X[2, 0] * c,
        X[0, 1] * a + X[1, 1] * b + X[2, 1] * c,
        X[0, 2] * a + X[1, 2] * b + X[2, 2] * c,
    )  # fmt: skip
    return (
        d,
        X[0, 0] * gx + X[0, 1] * gy + X[0, 2] * gz,
        X[1, 0] * gx + X[1, 1] * gy + X[1, 2] * gz,
        X[2, 0] * gx + X[2, 1] * gy + X[2, 2] * gz,
        px, py, pz,
    )  # fmt: skip


@njit(cache=True, inline="always", error_model="numpy")
def _add(H, b, jx, jy, jz, rx, ry, rz, residual, weight):  # type: ignore[no-untyped-def]
    """One residual whose point at r from the centre has the gradient j: into the upper triangle of H and b."""
    J = (jx, jy, jz, ry * jz - rz * jy, rz * jx - rx * jz, rx * jy - ry * jx)
    for r in range(6):
        w = weight * J[r]
        b[r] -= w * residual
        for c in range(r, 6):
            H[r, c] += w * J[c]


@njit(cache=True, error_model="numpy")
def normal_equations(model, scene, contacts, terms, X, centre, H, b):  # type: ignore[no-untyped-def]
    """Cost of pose X (4, 4), and its Gauss-Newton equations H (6, 6) twist = b (6,) about `centre`, camera frame.

    contacts: (K, 4) points that the object touches and the weight of each, as a share of all points together.
    """
    H[:] = 0.0
    b[:] = 0.0
    cost = _points_term(model, scene, terms, X, centre, H, b)
    if terms.free > 0.0:
        cost += _free_term(model, scene, terms, X, centre, H, b)
    if scene.table[0] != 0.0 or scene.table[1] != 0.0 or scene.table[2] != 0.0:
        cost += _table_term(model, scene, terms, X, centre, H, b)
    for k in range(contacts.shape[0]):
        cost += _contact_term(model, contacts[k], min(terms.points, scene.points.shape[0]), X, centre, H, b)
    for r in range(6):
        for c in range(r):
            H[r, c] = H[c, r]
    return cost


@njit(cache=True, error_model="numpy")
def _points_term(model, scene, terms, X, centre, H, b):  # type: ignore[no-untyped-def]
    k2 = terms.kernel_m * terms.kernel_m
    cost = 0.0
    for m in range(min(terms.points, scene.points.shape[0])):
        d, gx, gy, gz, px, py, pz = _point_residual(model, scene, X, m)
        ray = np.sqrt(px * px + py * py + pz * pz)
        if gx * px + gy * py + gz * pz > 0.2 * ray:  # the far side of the object: the camera cannot have seen it
            cost += k2
            continue
        cost += k2 * d * d / (d * d + k2)
        weight = (k2 / (d * d + k2)) ** 2
        _add(H, b, -gx, -gy, -gz, px - centre[0], py - centre[1], pz - centre[2], d, weight)
    return cost


@njit(cache=True, error_model="numpy")
def _free_term(model, scene, terms, X, centre, H, b):  # type: ignore[no-untyped-def]
    n_model = min(terms.model_points, model.points.shape[0])
    scale = terms.free * min(terms.points, scene.points.shape[0]) / (0.5 * n_model)
    height, width = scene.outside.shape
    cost = 0.0
    for m in range(n_model):
        x, y, z, towards = _posed(model, X, m)
        if towards >= 0.0:
            continue
        r, i, j = stick_out(scene.depth, scene.outside, scene.camera, scene.image_box, terms.margin_m, x, y, z)
        if r <= 0.0:
            continue
        weight = scale
        if r > FREE_HUBER_M:
            cost += scale * FREE_HUBER_M * (2.0 * r - FREE_HUBER_M)
            weight *= FREE_HUBER_M / r
        else:
            cost += scale * r * r
        du = 0.5 * (scene.outside[i, min(j + 1, width - 1)] - scene.outside[i, max(j - 1, 0)])
        dv = 0.5 * (scene.outside[min(i + 1, height - 1), j] - scene.outside[max(i - 1, 0), j])
        dv *= scene.camera[1] / scene.camera[0]
        if scene.depth[i, j] <= 0.0:
            du, dv = UNMEASURED * du, UNMEASURED * dv
        jz = r / z - (du * x + dv * y) / z
        _add(H, b, du, dv, jz, x - centre[0], y - centre[1], z - centre[2], r, weight)
    return cost


@njit(cache=True, error_model="numpy")
def _table_term(model, scene, terms, X, centre, H, b):  # type: ignore[no-untyped-def]
    """The lowest vertex touches the table, and a pose close to a stable one is pulled to it."""
    n = scene.table
    lowest, height = 0, 1.0e9
    for k in range(model.hull.shape[0]):
        h = _height(model.hull[k], X, n)
        if h < height:
            lowest, height = k, h
    q = model.hull[lowest]
    x = X[0, 0] * q[0] + X[0, 1] * q[1] + X[0, 2] * q[2] + X[0, 3]
    y = X[1, 0] * q[0] + X[1, 1] * q[1] + X[1, 2] * q[2] + X[1, 3]
    z = X[2, 0] * q[0] + X[2, 1] * q[1] + X[2, 2] * q[2] + X[2, 3]
    scale = terms.table * min(terms.points, scene.points.shape[0])
    k2 = TABLE_KERNEL_M * TABLE_KERNEL_M
    cost = scale * k2 * height * height / (height * height + k2)
    weight = scale * (k2 / (height * height + k2)) ** 2
    _add(H, b, n[0], n[1], n[2], x - centre[0], y - centre[1], z - centre[2], height, weight)
    return cost + _rest_term(model, terms, X, n, min(terms.points, scene.points.shape[0]), H, b)


@njit(cache=True, inline="always", error_model="numpy")
def _height(q, X, n):  # type: ignore[no-untyped-def]
    return (
        n[0] * (X[0, 0] * q[0] + X[0, 1] * q[1] + X[0, 2] * q[2] + X[0, 3])
        + n[1] * (X[1, 0] * q[0] + X[1, 1] * q[1] + X[1, 2] * q[2] + X[1, 3])
        + n[2] * (X[2, 0] * q[0] + X[2, 1] * q[1] + X[2, 2] * q[2] + X[2, 3])
        + n[3]
    )


@njit(cache=True, error_model="numpy")
def _rest_term(model, terms, X, n, n_points, H, b):  # type: ignore[no-untyped-def]
    """Geman-McClure on the angle between the table's normal and the nearest direction that a stable pose has down."""
    best, cosine = 0, -2.0
    for k in range(model.rests.shape[0]):
        e = -(_turned(X, model.rests[k], 0) * n[0] + _turned(X, model.rests[k], 1) * n[1]
              + _turned(X, model.rests[k], 2) * n[2])  # fmt: skip
        if e > cosine:
            best, cosine = k, e
    scale = terms.rest * n_points * model.radius * model.radius
    k2 = REST_KERNEL * REST_KERNEL
    if cosine < np.cos(REST_LIMIT):
        return scale * k2
    e = (_turned(X, model.rests[best], 0), _turned(X, model.rests[best], 1), _turned(X, model.rests[best], 2))
    s2 = 2.0 - 2.0 * cosine  # |e + n|^2
    weight = scale * (k2 / (s2 + k2)) ** 2
    # residual e + n, which w turns by w x e: its rows are the cross products of the axes with e
    for axis in range(3):
        J = np.zeros(6)
        if axis == 0:
            J[4], J[5] = e[2], -e[1]
        elif axis == 1:
            J[3], J[5] = -e[2], e[0]
        else:
            J[3], J[4] = e[1], -e[0]
        residual = e[axis] + n[axis]
        for r in range(3, 6):
            b[r] -= weight * J[r] * residual
            for c in range(r, 6):
                H[r, c] += weight * J[r] * J[c]
    return scale * k2 * s2 / (s2 + k2)


@njit(cache=True, inline="always", error_model="numpy")
def _turned(X, v, row):  # type: ignore[no-untyped-def]
    return X[row, 0] * v[0] + X[row, 1] * v[1] + X[row, 2] * v[2]


@njit(cache=True, error_model="numpy")
def _contact_term(model, contact, n_points, X, centre, H, b):  # type: ignore[no-untyped-def]
    """A point of a hand that touches the object: its distance to the surface, Geman-McClure."""
    p = contact
    a, bb, c = p[0] - X[0, 3], p[1] - X[1, 3], p[2] - X[2, 3]
    d, gx, gy, gz = grid_distance_gradient(
        model.values, model.origin, model.inv_spacing,
        X[0, 0] * a + X[1, 0] * bb + X[2, 0] * c,
        X[0, 1] * a + X[1, 1] * bb + X[2, 1] * c,
        X[0, 2] * a + X[1, 2] * bb + X[2, 2] * c,
    )  # fmt: skip
    k2 = CONTACT_KERNEL_M * CONTACT_KERNEL_M
    scale = contact[3] * n_points
    weight = scale * (k2 / (d * d + k2)) ** 2
    cx = X[0, 0] * gx + X[0, 1] * gy + X[0, 2] * gz
    cy = X[1, 0] * gx + X[1, 1] * gy + X[1, 2] * gz
    cz = X[2, 0] * gx + X[2, 1] * gy + X[2, 2] * gz
    _add(H, b, -cx, -cy, -cz, p[0] - centre[0], p[1] - centre[1], p[2] - centre[2], d, weight)
    return scale * k2 * d * d / (d * d + k2)


@njit(cache=True, error_model="numpy")
def move(X, centre, twist, out):  # type: ignore[no-untyped-def]
    """out (4, 4) = pose X moved by a twist [v, w] about `centre`, camera axes."""
    wx, wy, wz = twist[3], twist[4], twist[5]
    angle = np.sqrt(wx * wx + wy * wy + wz * wz)
    s, c = (1.0, 0.5) if angle < 1.0e-9 else (np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle))
    K = np.array([[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]])
    R = np.eye(3) + s * K + c * (K @ K)
    for i in range(3):
        t = twist[i] + centre[i]
        for j in range(3):
            out[i, j] = R[i, 0] * X[0, j] + R[i, 1] * X[1, j] + R[i, 2] * X[2, j]
            t += R[i, j] * (X[j, 3] - centre[j])
        out[i, 3] = t
        out[3, i] = 0.0
    out[3, 3] = 1.0


@njit(cache=True, error_model="numpy")
def polish(model, scene, contacts, terms, X_CO, steps, cost):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt on every pose (N, 4, 4), in place; cost (N,) out. Ends early where nothing is gained."""
    H, b = np.empty((6, 6)), np.empty(6)
    H_trial, b_trial = np.empty((6, 6)), np.empty(6)
    A, trial = np.empty((6, 6)), np.empty((4, 4))
    n_points = min(terms.points, scene.points.shape[0])
    scale = np.ones(6)
    scale[3:] = model.radius
    for n in range(X_CO.shape[0]):
        damping = 1.0e-2
        now = normal_equations(model, scene, contacts, terms, X_CO[n], scene.centroid, H, b)
        for _ in range(steps):
            for r in range(6):
                for c in range(6):
                    A[r, c] = H[r, c] / (scale[r] * scale[c])
                A[r, r] += damping * n_points + 1.0e-9
            twist = np.linalg.solve(A, b / scale) / scale
            length = np.sqrt(twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2)
            angle = np.sqrt(twist[3] ** 2 + twist[4] ** 2 + twist[5] ** 2)
            twist *= min(1.0, 0.05 / max(length, 1.0e-12), 0.5 / max(angle, 1.0e-12))
            move(X_CO[n], scene.centroid, twist, trial)
            new = normal_equations(model, scene, contacts, terms, trial, scene.centroid, H_trial, b_trial)
            if new < now:
                gain = now - new
                X_CO[n], now = trial, new
                H[:], b[:] = H_trial, b_trial
                damping = max(0.2 * damping, 1.0e-7)
                if gain < 1.0e-5 * now:
                    break
            else:
                damping *= 6.0
                if damping > 10.0:
                    break
        cost[n] = now
