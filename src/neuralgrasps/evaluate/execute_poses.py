"""The published pose estimates in the place of ours, for picks: Eq. 1, and Eq. 2 with the contacts of the grasp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.apply.sight import Sighting, TableView
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.paper_pose import GraspRun, baseline_pose, contact_pose


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperPoses:
    """Both estimates from the points of our mask.

    Attributes:
        run: a trained field with its grasps. hand: of the robot.
        seed: of the estimates.
    """

    run: GraspRun
    hand: Hand
    seed: int = 0

    def baseline(self, obj: ObjectModel, view: TableView, sighting: Sighting) -> np.ndarray:
        """X_BO by Eq. 1."""
        found = baseline_pose(self.run.field, None, _points(view, sighting), object_name=obj.name, seed=self.seed)
        return _in_base(view, found.X_CO)

    def contact(self, obj: ObjectModel, view: TableView, sighting: Sighting, X_BH: np.ndarray) -> np.ndarray:
        """X_BO by Eq. 2, the gripper at the planned grasp."""
        assert view.frame.X_WC is not None
        found = contact_pose(
            self.run,
            _points(view, sighting),
            np.linalg.inv(view.frame.X_WC) @ X_BH,
            hand=self.hand,
            object_name=obj.name,
            seed=self.seed,
        )
        return _in_base(view, found.X_CO)


def _points(view: TableView, sighting: Sighting) -> np.ndarray:
    assert sighting.mask is not None
    return np.asarray(view.frame.points[sighting.mask & (view.frame.depth > 0)])


def _in_base(view: TableView, X_CO: np.ndarray) -> np.ndarray:
    assert view.frame.X_WC is not None
    return np.asarray(view.frame.X_WC @ X_CO)
