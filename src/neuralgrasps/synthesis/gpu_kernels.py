"""CUDA kernels around the steps of `assess`: one thread per candidate, one kernel per step.

The steps are the CPU's own compiled functions; numba compiles them again for the GPU when a kernel calls them. Small
matrices live in a thread's local memory; everything longer is a row of an array whose first axis, the thread, runs
fastest in memory, so that neighbouring threads touch neighbouring words. Between two kernels the host drops the
candidates that failed, so that no thread idles for them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import cuda, float64

from neuralgrasps.grasps.contact import ContactScratch
from neuralgrasps.grasps.force_qp import ForceScratch
from neuralgrasps.grasps.penetration import PoseScratch
from neuralgrasps.grasps.polar import PolarScratch
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.synthesis.assess import (
    advance_hand,
    check_overlap,
    close_hand,
    grasp_epsilon_within,
    grasp_residual,
    touch,
)
from neuralgrasps.synthesis.close import CloseScratch


class HandArrays(NamedTuple):
    """The attributes of `PackedHand` that the kernels read."""

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    closing_rate: np.ndarray
    point_L: np.ndarray
    link_point_start: np.ndarray
    link_centre: np.ndarray
    link_radius: np.ndarray
    part_kind: np.ndarray
    part_link: np.ndarray
    part_X_PL: np.ndarray
    part_size: np.ndarray
    hull_plane_start: np.ndarray
    hull_planes: np.ndarray
    part_centre: np.ndarray
    part_radius: np.ndarray
    self_pairs: np.ndarray


class Batch(NamedTuple):
    """N candidates in the GPU's memory, R contacts at most in each.

    Attributes:
        q_start, q: (N, J); X_OH: (N, 4, 4); closed: (N,) bool; contacts: (N,) int32, how many.
        points, normals: (N, R, 3); links: (N, R) int32; score: (N,) epsilon or residual; penetration: (N,);
        outcome: (N,) int8.
    """

    q_start: np.ndarray
    X_OH: np.ndarray
    q: np.ndarray
    closed: np.ndarray
    contacts: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    links: np.ndarray
    score: np.ndarray
    penetration: np.ndarray
    outcome: np.ndarray


class Approach(NamedTuple):
    """N open hands on their way to an object, in the GPU's memory; arguments of `advance_hand`.

    Attributes:
        X_OH: (N, 4, 4); q: (N, J); direction: (N, 3); travel: (N,), written.
    """

    X_OH: np.ndarray
    q: np.ndarray
    direction: np.ndarray
    travel: np.ndarray
    contact_m: float
    farthest: float
    touching: bool


class Room(NamedTuple):
    """Work space of T threads; every array's first axis is the thread. See `Scratch` for the others.

    Attributes:
        X_HL: (T, L, 4, 4); at_centre: (T, C); active, busy: (T, J + 1) bool.
        points, normals: (T, K, 3), gap: (T, K): of one link.
    """

    X_HL: np.ndarray
    at_centre: np.ndarray
    active: np.ndarray
    busy: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    gap: np.ndarray


class ForceRoom(NamedTuple):
    """Work space of T balancing threads, W wrenches each: wrenches (T, W, 6), f, trial_f (T, W)."""

    wrenches: np.ndarray
    f: np.ndarray
    trial_f: np.ndarray


class PolarRoom(NamedTuple):
    """Work space of T threads that search for epsilon: wrenches (T, W, 6); the others as in `PolarScratch`."""

    wrenches: np.ndarray
    x: np.ndarray
    squared: np.ndarray
    gap: np.ndarray
    basis: np.ndarray
    mates: np.ndarray
    cut_off: np.ndarray
    free: np.ndarray
    rim: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    counts: np.ndarray


@cuda.jit(cache=True)
def advance_kernel(pair, hands, room, todo):  # type: ignore[no-untyped-def]
    """Move the open hands `todo` (M,) of an `Approach` towards the object: travel."""
    thread, threads = cuda.grid(1), room.gap.shape[0]
    if thread < threads:
        pose, moved = cuda.local.array((3, 4), float64), cuda.local.array((3, 4), float64)
        scratch = CloseScratch(pose, room.at_centre[thread], room.active[thread])
        X_HL = room.X_HL[thread]
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            pose_links(pair.packed, hands.q[i], X_HL)
            hands.travel[i] = advance_hand(
                pair, hands.X_OH[i], X_HL, hands.direction[i], hands.contact_m, hands.farthest, hands.touching,
                moved, scratch,
            )  # fmt: skip


@cuda.jit(cache=True)
def close_kernel(pair, batch, room, todo):  # type: ignore[no-untyped-def]
    """Close the candidates `todo` (M,): X_OH, q and closed."""
    thread, threads = cuda.grid(1), room.gap.shape[0]
    if thread < threads:
        pose = cuda.local.array((3, 4), float64)
        scratch = CloseScratch(pose, room.at_centre[thread], room.active[thread])
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            batch.closed[i] = close_hand(pair, batch.X_OH[i], batch.q[i], room.X_HL[thread], scratch)


@cuda.jit(cache=True)
def contact_kernel(pair, batch, room, todo):  # type: ignore[no-untyped-def]
    """Contacts of the closed candidates `todo` (M,): contacts, points, normals, links."""
    thread, threads = cuda.grid(1), room.gap.shape[0]
    if thread < threads:
        pose = cuda.local.array((3, 4), float64)
        scratch = ContactScratch(room.points[thread], room.normals[thread], room.gap[thread], pose)
        X_HL = room.X_HL[thread]
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            pose_links(pair.packed, batch.q[i], X_HL)
            batch.contacts[i] = touch(
                pair, batch.X_OH[i], X_HL, scratch, batch.points[i], batch.normals[i], batch.links[i]
            )


@cuda.jit(cache=True)
def force_kernel(cone, batch, room, todo):  # type: ignore[no-untyped-def]
    """What the best squeeze of the candidates `todo` (M,) leaves unbalanced: score."""
    thread, threads = cuda.grid(1), room.f.shape[0]
    if thread < threads:
        y, trial, step = cuda.local.array(7, float64), cuda.local.array(7, float64), cuda.local.array(7, float64)
        gradient, column = cuda.local.array(7, float64), cuda.local.array(7, float64)
        hessian = cuda.local.array((7, 7), float64)
        scratch = ForceScratch(room.f[thread], room.trial_f[thread], y, trial, step, gradient, column, hessian)
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            batch.score[i] = grasp_residual(
                cone, batch.points[i], batch.normals[i], batch.contacts[i], room.wrenches[thread], scratch
            )


@cuda.jit(cache=True)
def epsilon_kernel(cone, batch, room, todo):  # type: ignore[no-untyped-def]
    """Epsilon of the candidates `todo` (M,), -1 where the work space is too small: score."""
    thread, threads = cuda.grid(1), room.values.shape[0]
    if thread < threads:
        scratch = PolarScratch(
            room.x[thread], room.squared[thread], room.gap[thread], room.basis[thread], room.mates[thread],
            room.cut_off[thread], room.free[thread], room.rim[thread], room.columns[thread], room.values[thread],
            room.counts[thread],
        )  # fmt: skip
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            batch.score[i] = grasp_epsilon_within(
                cone, batch.points[i], batch.normals[i], batch.contacts[i], room.wrenches[thread], scratch
            )


@cuda.jit(cache=True)
def overlap_kernel(pair, batch, room, todo):  # type: ignore[no-untyped-def]
    """Overlap of the candidates `todo` (M,): outcome and penetration, and q where idle fingers open."""
    thread, threads = cuda.grid(1), room.gap.shape[0]
    if thread < threads:
        pose, first = cuda.local.array((3, 4), float64), cuda.local.array((3, 4), float64)
        second, third = cuda.local.array((3, 4), float64), cuda.local.array((3, 4), float64)
        close = CloseScratch(pose, room.at_centre[thread], room.active[thread])
        poses = PoseScratch(first, second, third)
        X_HL = room.X_HL[thread]
        for m in range(thread, todo.shape[0], threads):
            i = todo[m]
            pose_links(pair.packed, batch.q[i], X_HL)
            batch.outcome[i], batch.penetration[i] = check_overlap(
                pair, batch.X_OH[i], batch.q_start[i], batch.q[i], X_HL, batch.contacts[i], batch.links[i],
                room.busy[thread], close, poses,
            )  # fmt: skip
