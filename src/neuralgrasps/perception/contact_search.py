"""Poses of an object that a hand touches: contacts guide a second search and choose, the view keeps the last word."""

from __future__ import annotations

import numpy as np

from neuralgrasps.perception.contact import ContactPoints
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_confidence import surface_distances
from neuralgrasps.perception.pose_kernels import CONTACT_KERNEL_M
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.perception.pose_search import NO_CONTACTS, Candidates, PoseConfig, distinct, polished, search


def with_contact(
    model: PoseModel, scene: Observation, contact: ContactPoints, found: Candidates, config: PoseConfig
) -> Candidates:
    """The candidates of a view, and those of a second search that contacts pull, in the order that both together give.

    The second search's poses are polished again without contacts, so that all are the view's own optima: calibration
    errors of the hand move no pose, they can only choose another. None is preferred that explains the view worse than
    the best by more than `config.contact_share`.
    """
    points = np.asarray(contact.points_C, np.float64).reshape(-1, 3)
    sure = min((0.003 / contact.sigma_m) ** 2, 1.0)
    contacts = np.column_stack([points, np.full(len(points), config.contact_weight * sure / len(points))])
    guided = search(model, scene, contacts, config)
    guided = polished(model, scene, NO_CONTACTS, guided.X_CO, config, 2)
    X, cost = np.concatenate([found.X_CO, guided.X_CO]), np.concatenate([found.cost, guided.cost])
    share = config.contact_share * sure
    # what the contacts cannot change stays in the order of the view
    both = np.where(cost <= cost.min() + share, cost, cost + 1.0) + share * _missed(model, points, X, contact.sigma_m)
    order = distinct(model, X, both, len(X), model.same)
    return Candidates(X[order], both[order], np.concatenate([found.evidence, guided.evidence])[order])


def _missed(model: PoseModel, points_C: np.ndarray, X_CO: np.ndarray, sigma_m: float) -> np.ndarray:
    """(K,) how far the contacts are from the surface of each pose: 0 = all touch, 1 = none does."""
    k2 = max(2.0 * sigma_m, CONTACT_KERNEL_M) ** 2
    square = np.stack([surface_distances(model, points_C, X) for X in X_CO]) ** 2
    return (square / (square + k2)).mean(axis=1)
