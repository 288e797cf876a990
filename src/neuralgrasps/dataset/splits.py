"""Train, test and spare grasps of one hand and object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.schema import SplitEntry
from neuralgrasps.errors import InputError
from neuralgrasps.seeds import child_rng

TRAIN_LIMIT, TEST_LIMIT = 50, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """Ascending grasp indices, int64, of one hand and object; no index is in two parts."""

    train: np.ndarray
    test: np.ndarray
    spare: np.ndarray

    def part(self, name: str) -> np.ndarray:
        """The indices of "train", "test", "spare" or "all"."""
        parts = {"train": self.train, "test": self.test, "spare": self.spare}
        if name == "all":
            return np.sort(np.concatenate(list(parts.values())))
        if name not in parts:
            raise InputError(f"split part '{name}' is not known; expected train, test, spare or all.")
        return parts[name]

    def entry(self) -> SplitEntry:
        train, test, spare = (tuple(int(i) for i in part) for part in (self.train, self.test, self.spare))
        return SplitEntry(train=train, test=test, spare=spare)


def split_grasps(count: int, *, hand: str, object_name: str, seed: int) -> Split:
    """Divide `count` grasps into train, test and spare.

    From 55 grasps on: 50 train, 5 test, the rest spare, as published. Fewer: one in six is a
    test grasp (at most 5, at least 1 when there are 2), all others train: 24 gives 20 + 4, 12 gives 10 + 2.
    The choice is a seeded permutation, not the order of the grasps: that order is by farthest-point
    sampling, so its tail would be a test set of the easiest grasps and its head one of the oddest.
    """
    if count < 1:
        raise InputError(f"there are {count} grasps of {hand} on {object_name}; expected at least 1.")
    test = min(TEST_LIMIT, max(1, round(count / 6))) if count > 1 else 0
    train = min(TRAIN_LIMIT, count - test)
    order = child_rng(seed, "split", object_name, hand).permutation(count)
    return Split(
        train=np.sort(order[test : test + train]), test=np.sort(order[:test]), spare=np.sort(order[test + train :])
    )
