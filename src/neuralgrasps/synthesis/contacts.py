"""Contacts of settled grasps."""

from __future__ import annotations

import numpy as np

from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.synthesis.candidates import CONTACTS_PER_LINK, GraspProblem

TOUCH_M = 1.0e-3  # points nearer than this are contacts of a finished grasp


def contacts_of(problem: GraspProblem, X_OH: np.ndarray, X_HL: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contacts of N settled grasps: points of the hand, 2 mm apart, nearer than `TOUCH_M`, at most 3 a link.

    Returns:
        points (N, C, 3), outward normals (N, C, 3) and links (N, C), padded with nan, nan and -1.
    """
    count, room = len(X_OH), problem.hand.tree.num_links * CONTACTS_PER_LINK
    points, normals = np.full((count, room, 3), np.nan), np.full((count, room, 3), np.nan)
    links = np.full((count, room), -1, np.int32)
    for i in range(count):
        found = find_contacts(
            *problem.sdf_arrays, problem.hand_probe, X_OH[i], X_HL[i], TOUCH_M, CONTACTS_PER_LINK,
            points[i], normals[i], links[i],
        )  # fmt: skip
        points[i, found:], normals[i, found:], links[i, found:] = np.nan, np.nan, -1
    used = int((links >= 0).sum(axis=1).max(initial=0))
    return points[:, :used], normals[:, :used], links[:, :used]
