"""Train, test and spare grasps of one hand and object; hands and objects held out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.schema import SplitEntry
from neuralgrasps.errors import InputError, unknown_name
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

    def held_out(self) -> Split:
        """The split of a hand or object that is held out: every grasp is a test grasp."""
        nothing = np.zeros(0, np.int64)
        return Split(train=nothing, test=self.part("all"), spare=nothing)

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


def check_held_out(
    pairs: Sequence[tuple[str, str]], *, hands: Iterable[str] = (), objects: Iterable[str] = ()
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of hands and objects to hold out of `pairs` (hand, object), each once and sorted.

    Raises:
        UnknownNameError: a hand or object that is not in the pairs.
        InputError: nothing would be left to train on.
    """
    chosen: list[tuple[str, ...]] = []
    for kind, names, known in (("hand", hands, {h for h, _ in pairs}), ("object", objects, {o for _, o in pairs})):
        chosen.append(tuple(sorted(set(names))))
        for name in chosen[-1]:
            if name not in known:
                raise unknown_name(kind, name, known)
    if all(h in chosen[0] or o in chosen[1] for h, o in pairs):
        listed = ", ".join((*chosen[0], *chosen[1]))
        raise InputError(f"holding out {listed} leaves no pair of hand and object to train on; hold out fewer.")
    return chosen[0], chosen[1]


def sort_held_out(pairs: Sequence[tuple[str, str]], names: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """`check_held_out` of names that may be of hands or objects; a name of both means both.

    Raises:
        UnknownNameError: neither a hand nor an object of the pairs. InputError: as there.
    """
    names = set(names)
    hands, objects = {h for h, _ in pairs}, {o for _, o in pairs}
    for name in sorted(names - hands - objects):
        raise unknown_name("name", name, hands | objects)
    return check_held_out(pairs, hands=hands & names, objects=objects & names)
