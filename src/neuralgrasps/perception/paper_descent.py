"""What the published pose estimator is made of: 512 starting rotations, distances of a field, and Adam on a pose.

A pose is (w, t): a point p, relative to a fixed point of the camera frame, lies at exp(w) p + t in the object frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import torch

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.rotation import exp_so3, log_so3
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_gradient_numpy, query_grid_numpy
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, inverse_np
from neuralgrasps.hands.packed import PackedHand, pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, nearest_of_parts, part_poses_H
from neuralgrasps.model.field import GraspField
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.mlp_field import MlpField

STEP_DEG = 45.0
_CHUNK = 65_536  # points of the rotation grid evaluated at once
_FIRST_DECAY, _SECOND_DECAY, _EPSILON = 0.9, 0.999, 1e-8  # Adam's, the defaults everywhere


class Shape(Protocol):
    """A surface that points can be compared with."""

    def distances(self, points_O: np.ndarray) -> np.ndarray:
        """Signed distances (M,) of points (M, 3), metres."""
        ...

    def gradients(self, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances (M,) and their gradients (M, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class GridShape:
    """An object by its grid."""

    grid: SdfGrid

    def distances(self, points_O: np.ndarray) -> np.ndarray:
        return query_grid_numpy(self.grid, points_O)

    def gradients(self, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return query_grid_gradient_numpy(self.grid, points_O)


class PosedHandShape:
    """A hand at one pose in the object frame, exact."""

    def __init__(self, packed: PackedHand, X_OH: np.ndarray, q: np.ndarray) -> None:
        X_HL = np.empty((len(packed.parents), 4, 4))
        pose_links(packed, np.ascontiguousarray(q, np.float64), X_HL)
        self._X_HO = np.ascontiguousarray(inverse_np(X_OH))
        self._packed = packed
        self._X_PH = np.empty((len(packed.part_link), 3, 4))
        self._centre_H = np.empty((len(packed.part_link), 3))
        part_poses_H(packed, X_HL, self._X_PH, self._centre_H)

    def distances(self, points_O: np.ndarray) -> np.ndarray:
        return self.gradients(points_O)[0]

    def gradients(self, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out, gradients = np.empty(len(points_O)), np.empty((len(points_O), 3))
        _hand_gradients(self._packed, self._X_PH, self._centre_H, self._X_HO, points_O, out, gradients)
        return out, gradients


@njit(cache=True, error_model="numpy")
def _hand_gradients(packed, X_PH, centre_H, X_HO, points_O, out, gradients):  # type: ignore[no-untyped-def]
    part = 0
    for m in range(points_O.shape[0]):
        x, y, z = moved_point(X_HO, points_O[m, 0], points_O[m, 1], points_O[m, 2])
        out[m], part = nearest_of_parts(packed, X_PH, centre_H, part, x, y, z)
        gx, gy, gz = gradient_in_H(packed, X_PH, part, x, y, z)
        for k in range(3):
            gradients[m, k] = X_HO[0, k] * gx + X_HO[1, k] * gy + X_HO[2, k] * gz


class NetworkShape:
    """The object or the hand of any field at one code, by the field itself and its automatic gradients."""

    def __init__(
        self, field: GraspField, code: np.ndarray, which: Literal["object", "hand"], *, hand: str, object_name: str
    ) -> None:
        self._field, self._which, self._hand, self._object = field, which, hand, object_name
        device = field.device if isinstance(field, MlpField) else torch.device("cpu")
        self._code = torch.as_tensor(np.asarray(code, np.float32), device=device)[None]

    def _of(self, points_O: torch.Tensor) -> torch.Tensor:
        out = self._field(points_O, self._code, hand=self._hand, object_name=self._object)
        return (out.sdf_object if self._which == "object" else out.sdf_hand)[0]

    def distances(self, points_O: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return self._of(torch.as_tensor(points_O).to(self._code)).double().cpu().numpy()

    def gradients(self, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = torch.as_tensor(points_O).to(self._code).requires_grad_()
        with torch.enable_grad():
            distance = self._of(points)
            (gradient,) = torch.autograd.grad(distance.sum(), points)
        return distance.detach().double().cpu().numpy(), gradient.double().cpu().numpy()


def object_shape(field: GraspField, code: np.ndarray | None, *, object_name: str) -> Shape:
    """The object part of a field: the grid itself of a `KinematicField`, the network of any other.

    Raises:
        UnknownNameError: not an object of the field; InputError: a network without a code.
    """
    if isinstance(field, KinematicField):
        return GridShape(field.object(object_name).sdf)
    if code is None:
        raise InputError("code is None; expected the code of a grasp: what this field says of an object depends on it.")
    return NetworkShape(field, code, "object", hand="", object_name=object_name)


def hand_shape(field: GraspField, code: np.ndarray, *, hand: str, object_name: str) -> Shape:
    """The hand part of a field at a code."""
    if not isinstance(field, KinematicField):
        return NetworkShape(field, code, "hand", hand=hand, object_name=object_name)
    grasp = field.decode(torch.as_tensor(np.asarray(code, np.float64))[None], hand=hand, object_name=object_name)
    return PosedHandShape(field.packed[hand], grasp.X_OH[0].numpy(), grasp.q[0].numpy())


def object_centre(field: GraspField, object_name: str) -> np.ndarray:
    """(3,) origin of the normalised units, object frame, metres; the object frame's own for fields without any."""
    if isinstance(field, KinematicField):
        field.object(object_name)
        return field.object_codecs[object_name].offset_O
    return np.asarray(field.normalisation.offset_O if isinstance(field, MlpField) else np.zeros(3), np.float64)


def euler_rotations() -> np.ndarray:
    """(512, 3, 3) rotations Rx(a) Ry(b) Rz(c), every angle one of 0, 45, ..., 315 degrees; c changes fastest.

    Only 208 of them differ: (a, b, c) and (a + 180, 180 - b, c + 180) are one rotation, and where b is 90 or 270
    degrees only a + c or a - c matters.
    """
    angles = np.deg2rad(np.arange(0.0, 360.0, STEP_DEG))
    Rx, Ry, Rz = (axis_angle_matrix(np.tile(axis, (len(angles), 1)), angles) for axis in np.eye(3))
    return (Rx[:, None, None] @ Ry[None, :, None] @ Rz[None, None]).reshape(-1, 3, 3)


def rotation_losses(shape: Shape, points: np.ndarray, rotations: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(G,) mean |distance| of points (M, 3) turned by each of (G, 3, 3) rotations and moved to `t` (3,) or (G, 3)."""
    _, first, which = np.unique(np.round(rotations.reshape(-1, 9), 6), axis=0, return_index=True, return_inverse=True)
    offsets = np.broadcast_to(t, (len(rotations), 3))[first]
    losses = np.empty(len(first))
    step = max(1, _CHUNK // len(points))
    for i in range(0, len(first), step):
        some = slice(i, i + step)
        moved = points @ rotations[first[some]].transpose(0, 2, 1) + offsets[some, None]
        losses[some] = np.abs(shape.distances(moved.reshape(-1, 3))).reshape(moved.shape[:2]).mean(axis=1)
    return losses[which.reshape(-1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """The sum over points of weight * |distance to shape|.

    Attributes:
        points: (M, 3) relative to the point that rotations turn about, camera axes, metres; weights: (M,).
    """

    shape: Shape
    points: np.ndarray
    weights: np.ndarray


def loss_gradient(terms: Sequence[Term], w: np.ndarray, t: np.ndarray) -> tuple[float, np.ndarray]:
    """The sum of the terms at a pose, metres, and its gradient (6,) by [w, t]."""
    R = np.empty((3, 3))
    _exp(w, R)
    loss, force, torque = 0.0, np.zeros(3), np.zeros(3)
    for term in terms:
        turned = term.points @ R.T
        distance, gradient = term.shape.gradients(turned + t)
        loss += _add(turned, distance, gradient, term.weights, force, torque)
    out = np.empty(6)
    _to_parameters(w, force, torque, out)
    return loss, out


@njit(cache=True, error_model="numpy")
def _exp(w, R):  # type: ignore[no-untyped-def]
    """Rotation vector to matrix, as `geometry.rotation.exp_so3`, without torch's cost per call."""
    a, b, _ = _coefficients(w)
    R[:] = 0.0
    for i in range(3):
        R[i, i] = 1.0 - b * (w[(i + 1) % 3] ** 2 + w[(i + 2) % 3] ** 2)
        j, k = (i + 1) % 3, (i + 2) % 3
        R[j, i] = b * w[i] * w[j] + a * w[k]
        R[i, j] = b * w[i] * w[j] - a * w[k]


@njit(cache=True, inline="always", error_model="numpy")
def _coefficients(w):  # type: ignore[no-untyped-def]
    """sin(t) / t, (1 - cos t) / t^2, (t - sin t) / t^3 of t = |w|."""
    s = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    if s < 1e-4:
        return 1.0 - s / 6.0, 0.5 - s / 24.0, 1.0 / 6.0 - s / 120.0
    t = math.sqrt(s)
    return math.sin(t) / t, (1.0 - math.cos(t)) / s, (t - math.sin(t)) / (s * t)


@njit(cache=True, error_model="numpy")
def _add(turned, distance, gradient, weights, force, torque):  # type: ignore[no-untyped-def]
    """sum weight * |distance|; its change by a shift is added to `force`, by a turn in the object frame to `torque`."""
    total = 0.0
    for m in range(turned.shape[0]):
        total += weights[m] * abs(distance[m])
        sign = weights[m] * np.sign(distance[m])
        gx, gy, gz = sign * gradient[m, 0], sign * gradient[m, 1], sign * gradient[m, 2]
        x, y, z = turned[m, 0], turned[m, 1], turned[m, 2]
        force[0] += gx
        force[1] += gy
        force[2] += gz
        torque[0] += y * gz - z * gy
        torque[1] += z * gx - x * gz
        torque[2] += x * gy - y * gx
    return total


@njit(cache=True, error_model="numpy")
def _to_parameters(w, force, torque, out):  # type: ignore[no-untyped-def]
    """Gradient by [w, t]: exp(w + dw) = exp(J dw) exp(w), so the torque is taken back by the transpose of J."""
    _, b, c = _coefficients(w)
    wx, wy, wz = w[0], w[1], w[2]
    ux = wy * torque[2] - wz * torque[1]
    uy = wz * torque[0] - wx * torque[2]
    uz = wx * torque[1] - wy * torque[0]
    out[0] = torque[0] - b * ux + c * (wy * uz - wz * uy)
    out[1] = torque[1] - b * uy + c * (wz * ux - wx * uz)
    out[2] = torque[2] - b * uz + c * (wx * uy - wy * ux)
    out[3], out[4], out[5] = force[0], force[1], force[2]


def descend(
    terms: Sequence[Term], R: np.ndarray, t: np.ndarray, *, steps: int, rate: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Adam on (w, t) from a rotation (3, 3) and a translation (3,): where it ends (R, t), and the terms' sum there."""
    pose = np.concatenate([log_so3(torch.as_tensor(np.asarray(R, np.float64))).numpy(), t])
    first, second = np.zeros(6), np.zeros(6)
    for step in range(1, steps + 1):
        _, gradient = loss_gradient(terms, pose[:3], pose[3:])
        _adam(pose, gradient, first, second, step, rate)
    loss, _ = loss_gradient(terms, pose[:3], pose[3:])
    return exp_so3(torch.from_numpy(pose[:3])).numpy(), pose[3:], loss


@njit(cache=True, error_model="numpy")
def _adam(pose, gradient, first, second, step, rate):  # type: ignore[no-untyped-def]
    for k in range(6):
        first[k] += (1.0 - _FIRST_DECAY) * (gradient[k] - first[k])
        second[k] += (1.0 - _SECOND_DECAY) * (gradient[k] * gradient[k] - second[k])
        mean = first[k] / (1.0 - _FIRST_DECAY**step)
        size = math.sqrt(second[k] / (1.0 - _SECOND_DECAY**step))
        pose[k] -= rate * mean / (size + _EPSILON)
