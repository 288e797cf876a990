"""Which postures a person's hand takes at an object: a Gaussian of this library's own human grasps. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.model.run_notes import GRASPS_FOLDER, run_folder

_RUN = "standins7"
_OPENING_SHARE = 0.5  # weight of the open hand before a grasp, of the closed one
_OWN_SD = 0.10  # rad, added to what the examples show: they are a machine's


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Postures:
    """A distribution of postures of the 20 joints, rad.

    Attributes:
        mean: (20,); precision: (20, 20) inverse covariance; open, closed: (20,) the means of the hands before and at
            their grasps.
    """

    mean: np.ndarray
    precision: np.ndarray
    open: np.ndarray
    closed: np.ndarray


@cache
def usual_postures() -> Postures:
    """Postures of the 420 human grasps of the shipped run, and of the hands just before them."""
    files = sorted((run_folder(_RUN) / GRASPS_FOLDER).glob("*/human.safetensors"))
    grasps = [load_grasps(file) for file in files]
    closed, opened = (np.concatenate(rows) for rows in zip(*((g.q, g.q_pregrasp) for g in grasps), strict=True))
    mean = (1.0 - _OPENING_SHARE) * closed.mean(axis=0) + _OPENING_SHARE * opened.mean(axis=0)
    covariance = _OWN_SD**2 * np.eye(len(mean))
    for share, q in ((1.0 - _OPENING_SHARE, closed), (_OPENING_SHARE, opened)):
        covariance += share * (q - mean).T @ (q - mean) / len(q)
    return Postures(
        mean=mean, precision=np.linalg.inv(covariance), open=opened.mean(axis=0), closed=closed.mean(axis=0)
    )
