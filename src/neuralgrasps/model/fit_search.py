"""Search for the pose and joints of a hand behind a cloud of points: many starts, then fewer and finer fits.

Every round scores starts on few points, improves the best roughly, and refines the best of those on all points. The
first round starts from known grasps; later ones, only while the points lie farther from the hand than their noise
explains, from crossings and variations of what was found. Torch-free.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.geometry.sdf_grid import SdfGrid, query_grid_numpy
from neuralgrasps.hands.packed import PackedHand, hand_distance_many
from neuralgrasps.model.fit_config import Fit, InferConfig, Search, Starts
from neuralgrasps.model.fit_kernels import FitProblem, fit_cost
from neuralgrasps.model.fit_prior import DEPTH_SD_M, GraspPrior, posed_points
from neuralgrasps.model.fit_solver import fit_hand, fit_starts, score_starts
from neuralgrasps.model.fit_view import visible_points

MIN_NOISE_M = 0.0003  # models and sensors are no better; keeps the priors from vanishing on clean points
POSTURE_FREEDOM = 5.0
TOUCH_WIDTH_M = 0.0015
EFFECTIVE_POINTS = 100.0  # so many independent points is a cloud worth against the priors
COARSE_WIDTH_M, MIDDLE_WIDTH_M, FINE_WIDTH_M = 0.03, 0.015, 0.006  # distances beyond count linearly
PRIOR_TRUST = 0.1  # priors weigh so much less with every late round: points decide against them
GAP_M = 0.006  # observed points of a view lie no farther apart
EVEN_POINTS = 192  # well spread points kept for the first stages
LONELY_RANK = 4  # a point whose neighbour of this rank
LONELY_TIMES = 4.0  # is so many times as far as that of the middle point has nothing to do with a hand
LONELY_SHARE = 0.01  # unless there are no more such points
OUTLIER_M, OUTLIER_SIGMAS = 0.001, 4.0  # beyond, a point's distance to the hand is no noise
ON_OBJECT_M, ON_OBJECT_SIGMAS = 0.001, 3.0  # up to there, a point may be the object's
ASIDE_SIGMAS = 4.0  # and up to there, if no hand is near, it is
SPILL_SHARE = 0.01  # of the points set aside on the object, to search again with these trusted less
STRAY_SHARE = 0.005  # where some are no hand's, so many points may be anywhere without being noticed
SURE_SHARE = 0.3  # with so many points off the object, these alone tell whether a hand fits
OBJECT_WEIGHT = 0.2  # of points that may be the object's
NOISE_CUT = 9.0  # differences above so many times their median are no noise: 6 standard deviations
MAX_NOISE_M = 0.01  # larger differences count as this: no noise explains everything
SAME_HAND_M = 0.004  # mean distance of matching points below which two fits are the same


def lonely(cloud_O: np.ndarray) -> np.ndarray:
    """(M,) bool: points whose few nearest neighbours are many times as far as is usual in the cloud.

    None when they are very few: these may be all that a camera sees of a finger.
    """
    if len(cloud_O) <= LONELY_RANK:
        return np.zeros(len(cloud_O), np.bool_)
    away = KDTree(cloud_O).query(cloud_O, k=LONELY_RANK + 1)[0][:, -1]
    alone = away > LONELY_TIMES * np.median(away)
    return alone & (alone.mean() > LONELY_SHARE)


class CloudSearch:
    """The search for one cloud."""

    def __init__(
        self,
        packed: PackedHand,
        sdf: SdfGrid,
        prior: GraspPrior,
        cloud_O: np.ndarray,
        *,
        config: InferConfig,
        rng: np.random.Generator,
        viewpoint_O: np.ndarray | None = None,
    ) -> None:
        self.viewpoint_O = viewpoint_O
        self.packed, self.sdf, self.prior, self.config, self.rng = packed, sdf, prior, config, rng
        cloud = rng.permutation(cloud_O) if len(cloud_O) > config.points else cloud_O
        self.trust = 1.0
        cloud = cloud[: config.points]
        self.cloud = np.ascontiguousarray(cloud[~lonely(cloud)])
        self.left_out = len(cloud) - len(self.cloud)
        chosen = farthest_points(self.cloud, min(EVEN_POINTS, len(self.cloud)))
        self.even = np.ascontiguousarray(self.cloud[chosen])
        self.object_m = query_grid_numpy(sdf, self.cloud)
        self.object_even_m = self.object_m[chosen]
        self.spilled = False  # whether some points seem to be the object's: all near it are trusted less
        self.aside = np.zeros(len(self.cloud), np.bool_)
        away, near = KDTree(self.cloud).query(self.cloud, k=min(17, len(self.cloud)))
        self.neighbour, self.spacing_m = near[:, -1], float(np.median(away[:, min(LONELY_RANK, len(near) - 1)]))
        self.noise_m = max(config.noise_m if config.noise_m is not None else 0.0015, MIN_NOISE_M)

    def problem(self, points_O: np.ndarray, object_m: np.ndarray, width: float, coverage: float) -> FitProblem:
        """The fit to some points, whose distances to the object are `object_m`."""
        unit = self.trust * self.config.prior * self.noise_m**2 / EFFECTIVE_POINTS
        return FitProblem(
            points_O=points_O,
            object_weight=np.where(self.near_object(object_m) & self.spilled, OBJECT_WEIGHT, 0.0),
            width=max(width, 3.0 * self.noise_m),
            material=self.prior.material,
            cover=np.full(len(self.prior.material), coverage / len(self.prior.material)),
            seen_O=self.even,
            cover_free=0.0,
            cover_width=max(width, 3.0 * self.noise_m),
            q_mean=self.prior.q_mean,
            q_precision=self.prior.q_precision,
            q_freedom=POSTURE_FREEDOM,
            q_unit=unit,
            probe=self.prior.probe,
            touch_mean=self.prior.touch_mean,
            touch_weight=unit / self.prior.touch_sd**2,
            touch_width=TOUCH_WIDTH_M,
            depth_weight=unit / DEPTH_SD_M**2,
            depth_width=0.003,
            depth_free=0.001,
            sdf_values=self.sdf.values,
            sdf_origin=self.sdf.origin,
            sdf_inv_spacing=self.sdf.inv_spacing,
        )

    def run(self, gallery: Starts) -> Search:
        found: list[Fit] = []
        excess, turn = np.inf, 0
        for turn in range(self.config.rounds):
            self.trust = PRIOR_TRUST ** max(turn - 2, 0)
            starts = gallery if turn == 0 else self.turned(gallery) if turn % 2 else self.varied(gallery, found)
            found = self.ranked(found + self.round(starts))
            excess = self.update_noise(found[0])
            if turn == 0 and (excess > self.config.good or self.object_share() > SPILL_SHARE):
                self.spilled = True
                found = self.ranked(found + self.round(gallery))
                excess = self.update_noise(found[0])
                self.spilled = self.object_share() > SPILL_SHARE
            if excess <= self.config.good:
                break
        found[0] = self.polished(found[0])
        excess = self.update_noise(found[0])
        outliers = (self.left_out + int(self.aside.sum())) / (self.left_out + len(self.cloud))
        return Search(
            fits=tuple(found), noise_m=self.noise_m, aside=self.aside, outliers=outliers, excess=excess, rounds=turn + 1
        )

    def update_noise(self, best: Fit) -> float:
        """Go by the noise and the outliers that the best fit shows; the others' variance in units of the noise's."""
        shown = self.estimated_noise(best.distance_m)
        known = self.config.noise_m
        self.noise_m = max(shown if known is None else known, MIN_NOISE_M)
        self.aside = self.set_aside(best.distance_m)
        kept = self.sure() & ~self.aside
        if not kept.any():
            return np.inf
        squared = np.sort(best.distance_m[kept] ** 2)
        if self.spilled or self.left_out:
            squared = squared[: math.ceil((1.0 - STRAY_SHARE) * len(squared))]
        return float(squared.mean()) / max(min(shown, self.noise_m), MIN_NOISE_M) ** 2

    def object_share(self) -> float:
        """Share of the points that are set aside, and on the object."""
        return float((self.aside & self.near_object(self.object_m, ASIDE_SIGMAS)).mean())

    def sure(self) -> np.ndarray:
        """(M,) bool: points that cannot be the object's, when some points are and others are enough; else all."""
        if not self.spilled:
            return np.ones(len(self.cloud), np.bool_)
        sure = ~self.near_object(self.object_m)
        return sure if sure.mean() > SURE_SHARE else np.ones(len(sure), np.bool_)

    def near_object(self, object_m: np.ndarray, sigmas: float | None = None) -> np.ndarray:
        """Which of points with these distances to the object may be the object's."""
        return np.abs(object_m) < ON_OBJECT_M + (ON_OBJECT_SIGMAS if sigmas is None else sigmas) * self.noise_m

    def unexplained(self, distance_m: np.ndarray) -> np.ndarray:
        """(M,) bool: points whose distance to a hand is more than noise."""
        return np.abs(distance_m) > OUTLIER_M + OUTLIER_SIGMAS * self.noise_m

    def set_aside(self, distance_m: np.ndarray) -> np.ndarray:
        """(M,) bool: unexplained points that tell nothing of the hand. Those that lie together may be its fingers."""
        aside = self.unexplained(distance_m)
        alone = np.flatnonzero(aside & ~self.near_object(self.object_m, ASIDE_SIGMAS))
        if not self.left_out:
            aside[alone] = False
        elif len(alone) > LONELY_RANK:
            away = KDTree(self.cloud[alone]).query(self.cloud[alone], k=LONELY_RANK + 1)[0][:, -1]
            aside[alone] = away > LONELY_TIMES * self.spacing_m
        return aside

    def polished(self, fit: Fit) -> Fit:
        """Fitted again to all points, with the weights that go with the noise as it is known now."""
        X, q, c = fit.X_OH.copy(), fit.q.copy(), self.config
        cost, _, stopped = fit_hand(self.packed, self.seen_problem(X, q, ~self.aside), X, q, c.fine_iterations)
        return Fit(X_OH=X, q=q, cost=float(cost), distance_m=self.distances(X, q), stopped=bool(stopped))

    def round(self, starts: Starts) -> list[Fit]:
        c = self.config
        first, then = slice(c.coarse_points), slice(c.middle_points)
        problem = self.problem(self.even[first], self.object_even_m[first], COARSE_WIDTH_M, c.coverage)
        cost, stopped = np.empty(len(starts)), np.zeros(len(starts), np.bool_)
        score_starts(self.packed, problem, starts.X_OH, starts.q, cost)
        some = starts.take(np.argsort(cost, kind="stable")[: c.starts])
        cost, stopped = np.empty(len(some)), np.zeros(len(some), np.bool_)
        fit_starts(self.packed, problem, some.X_OH, some.q, c.coarse_iterations, cost, stopped)
        for points, object_m, width, coverage, keep, steps in (
            (self.even[then], self.object_even_m[then], MIDDLE_WIDTH_M, c.coverage, c.middle, c.middle_iterations),
            (self.cloud, self.object_m, FINE_WIDTH_M, 0.0, c.finalists, c.fine_iterations),
        ):
            some = some.take(self.different(some, np.argsort(cost, kind="stable"), keep))
            cost, stopped = np.empty(len(some)), np.zeros(len(some), np.bool_)
            problem = self.problem(points, object_m, width, coverage)
            fit_starts(self.packed, problem, some.X_OH, some.q, steps, cost, stopped)
        if self.viewpoint_O is not None:
            for i, (X, q) in enumerate(zip(some.X_OH, some.q, strict=True)):
                cost[i], _, stopped[i] = fit_hand(self.packed, self.seen_problem(X, q), X, q, c.middle_iterations)
        return [
            Fit(X_OH=X, q=q, cost=float(value), distance_m=self.distances(X, q), stopped=bool(done))
            for X, q, value, done in zip(some.X_OH, some.q, cost, stopped, strict=True)
        ]

    def seen_problem(self, X_OH: np.ndarray, q: np.ndarray, kept: np.ndarray | None = None) -> FitProblem:
        """The last problem; with a viewpoint, hand that the camera must have seen here has to have points near.

        `kept`: (M,) bool, of the cloud; None: all.
        """
        points, object_m = (self.cloud, self.object_m) if kept is None else (self.cloud[kept], self.object_m[kept])
        problem = self.problem(points, object_m, FINE_WIDTH_M, 0.0)
        if kept is not None:
            problem = problem._replace(object_weight=np.zeros(len(points)))
        if self.viewpoint_O is None:
            return problem
        return problem._replace(
            cover=self.config.view * self.visible(X_OH, q) / len(self.prior.material),
            seen_O=self.cloud,
            cover_free=GAP_M + 2.0 * self.noise_m,
        )

    def visible(self, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(K,) bool: which of the hand's `material` points the camera sees."""
        assert self.viewpoint_O is not None
        chosen, sdf = self.prior.material, self.sdf
        out = np.zeros(len(chosen), np.bool_)
        visible_points(self.packed, chosen, X_OH, q, self.viewpoint_O, sdf.values, sdf.origin, sdf.inv_spacing, out)
        return out

    def distances(self, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
        out = np.empty(len(self.cloud))
        hand_distance_many(self.packed, X_OH, q, self.cloud, out)
        return out

    def estimated_noise(self, distance_m: np.ndarray) -> float:
        """Noise from differences between neighbouring points: a wrong hand is wrong smoothly, noise is not."""
        sure = self.sure()
        chosen = np.flatnonzero(sure & sure[self.neighbour])
        chosen = chosen if len(chosen) >= 10 else np.arange(len(sure))
        difference = np.abs(distance_m[chosen] - distance_m[self.neighbour[chosen]])
        usual = difference[difference <= max(NOISE_CUT * float(np.median(difference)), MIN_NOISE_M)]
        return float(np.sqrt(0.5 * np.mean(np.minimum(usual, MAX_NOISE_M) ** 2)))

    def different(self, some: Starts, order: np.ndarray, count: int) -> np.ndarray:
        """The first `count` of `order` that are not nearly the same hand as one before."""
        kept: list[int] = []
        points: list[np.ndarray] = []
        marks = self.prior.material[::4]
        for i in order:
            p = posed_points(self.packed, some.X_OH[i], some.q[i], marks)
            if all(np.linalg.norm(p - other, axis=1).mean() > SAME_HAND_M for other in points):
                kept.append(int(i))
                points.append(p)
                if len(kept) == count:
                    break
        return np.array(kept)

    def ranked(self, fits: list[Fit]) -> list[Fit]:
        """Different fits, the best first by what all are judged by now."""
        fits = [
            replace(f, cost=float(fit_cost(self.packed, self.seen_problem(f.X_OH, f.q), f.X_OH, f.q))) for f in fits
        ]
        fits.sort(key=lambda f: f.cost)
        some = Starts(X_OH=np.stack([f.X_OH for f in fits]), q=np.stack([f.q for f in fits]))
        return [fits[i] for i in self.different(some, np.arange(len(fits)), len(fits))]

    def turned(self, gallery: Starts) -> Starts:
        """Known grasps turned about the object's middle to where the points are, rolled about that direction."""
        c, rng = self.config, self.rng
        count = c.variations
        donor = rng.integers(len(gallery), size=count)
        X, q = gallery.X_OH[donor].copy(), gallery.q[donor]
        middle = 0.5 * (self.sdf.bounds[0] + self.sdf.bounds[1])
        marks = self.prior.material[::4]
        hand = np.stack([posed_points(self.packed, a, b, marks).mean(axis=0) for a, b in zip(X, q, strict=True)])
        goal = self.even.mean(axis=0) + rng.normal(scale=c.vary_m, size=(count, 3))
        away, wanted = hand - middle, goal - middle
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
        axis = np.cross(away, wanted)
        sine = np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.arctan2(sine, (away * wanted).sum(axis=1, keepdims=True))
        turn = Rotation.from_rotvec(wanted * rng.uniform(-np.pi, np.pi, (count, 1))) * Rotation.from_rotvec(
            axis / np.maximum(sine, 1e-9) * angle
        )
        turn = Rotation.from_rotvec(rng.normal(scale=c.vary_rad, size=(count, 3))) * turn
        R = turn.as_matrix()
        X[:, :3, 3] = np.einsum("nij,nj->ni", R, X[:, :3, 3] - hand) + goal
        X[:, :3, :3] = R @ X[:, :3, :3]
        return Starts(X_OH=X, q=q)

    def varied(self, gallery: Starts, found: list[Fit]) -> Starts:
        """Crossings of what was found with known postures, and both shaken."""
        c, rng = self.config, self.rng
        count, joints = c.variations, gallery.q.shape[1]
        donor = rng.integers(len(gallery), size=count)
        parent = np.minimum(rng.geometric(0.5, size=count) - 1, len(found) - 1)
        X = np.stack([found[i].X_OH for i in parent])
        q = np.stack([found[i].q for i in parent])
        first = rng.integers(joints, size=count)
        last = first + rng.integers(1, joints + 1, size=count)
        place = np.arange(joints)
        crossed = (place >= first[:, None]) & (place < last[:, None])
        q = np.where(crossed, gallery.q[donor], q)
        fresh = rng.random(count) < 0.3
        X[fresh], q[fresh] = gallery.X_OH[donor[fresh]], gallery.q[donor[fresh]]
        shaken = fresh | (rng.random(count) < 0.5)
        size = np.where(shaken, 1.0, 0.0)[:, None]
        X[:, :3, :3] = (
            X[:, :3, :3] @ Rotation.from_rotvec(size * rng.normal(scale=c.vary_rad, size=(count, 3))).as_matrix()
        )
        X[:, :3, 3] += size * rng.normal(scale=c.vary_m, size=(count, 3))
        span = self.packed.upper - self.packed.lower
        q = q + size * rng.normal(scale=c.vary_joint, size=q.shape) * span
        return Starts(X_OH=X, q=np.clip(q, self.packed.lower, self.packed.upper))
