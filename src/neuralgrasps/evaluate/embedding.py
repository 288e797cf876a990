"""Two-dimensional pictures of codes by Barnes-Hut t-SNE, of one object or of all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.model.codes import CodeBook

FEWEST = 10  # codes that make a picture worth looking at
DIRECTIONS, WIDTH_RAD = 64, 0.35
PICTURED_PER_OBJECT, PICTURED_OVERALL = 12, 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Embedding:
    """A t-SNE picture.

    Attributes:
        title: the object's name, or "all objects".
        rows: (N,) int64 rows of the code book. points: (N, 2) float64, without unit or meaning of their own.
        pictured: (K,) int64 places in `rows` that are spread over the plane, to be shown as pictures.
    """

    title: str
    rows: np.ndarray
    points: np.ndarray
    pictured: np.ndarray


def embed_codes(codes: np.ndarray, *, seed: int, perplexity: float = 30.0) -> np.ndarray:
    """Place codes in the plane so that near codes are near.

    Args:
        codes: (N, D), N >= 5; compared by Manhattan distance, like retrieval does.
        seed: of the start; perplexity: about how many neighbours count, lowered to (N - 1) / 3 for few codes.
    Returns:
        (N, 2) float64.
    Source:
        van der Maaten 2014, "Accelerating t-SNE using tree-based algorithms"; scikit-learn.
    """
    from sklearn.manifold import TSNE  # noqa: PLC0415 - slow to import

    check_shape("codes", np.shape(codes), (None, None))
    if len(codes) < 5:
        raise InputError(f"{len(codes)} codes were given; a picture needs at least 5.")
    method = TSNE(
        perplexity=min(perplexity, (len(codes) - 1) / 3.0),
        metric="manhattan",
        init="pca",
        method="barnes_hut",
        random_state=seed % 2**32,
    )
    return method.fit_transform(np.asarray(codes, np.float32)).astype(np.float64)


def embed_book(
    book: CodeBook, places: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None, *, seed: int
) -> tuple[Embedding, ...]:
    """One picture per object, by what retrieval compares, and one of all objects by `contact_directions`.

    Codes of different objects cannot be compared as they are: the cells of the contact part belong to the
    object, the posture part to the hand, and the palm part says nothing of the fingers. From which sides the hand
    touches, seen from the object's centre, has one meaning for every hand and object; it is read off the contact maps.

    Args:
        book: codes with contact maps. places: object -> (contact points (P, 3), centre (3,)); no picture of all
            objects when None, or with fewer than two objects.
    """
    pictures = []
    for name in book.objects:
        rows = np.flatnonzero(book.where(object_name=name))
        if len(rows) >= FEWEST:
            points = embed_codes(book.metric[rows], seed=seed)
            shown = spread_points(points, PICTURED_PER_OBJECT)
            pictures.append(Embedding(title=name, rows=rows, points=points, pictured=shown))
    if places is None or len(pictures) < 2:
        return tuple(pictures)
    rows = np.concatenate([p.rows for p in pictures])
    seen = [contact_directions(book.contact_maps[p.rows], *places[p.title]) for p in pictures]
    points = embed_codes(np.concatenate(seen), seed=seed)
    # the same grasps as in the pictures of the objects, so that none is drawn for this one alone
    drawn = np.flatnonzero(np.isin(rows, np.concatenate([p.rows[p.pictured] for p in pictures])))
    shown = drawn[spread_points(points[drawn], PICTURED_OVERALL)]
    return (Embedding(title="all objects", rows=rows, points=points, pictured=shown), *pictures)


def contact_directions(maps: np.ndarray, points_O: np.ndarray, centre_O: np.ndarray) -> np.ndarray:
    """How much a hand touches in each of 64 directions from the object's centre, whatever the object.

    Args:
        maps: (N, P) closeness at points_O (P, 3), object frame, metres; centre_O: (3,).
    Returns:
        (N, 64) float64: mean closeness of the points around each direction, weighted by exp(-(angle / 0.35)^2 / 2).
    """
    points_O = np.asarray(points_O, np.float64)
    check_shape("points_O", points_O.shape, (maps.shape[1], 3))
    arms = points_O - centre_O
    arms /= np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-12)
    angle = np.arccos(np.clip(_directions() @ arms.T, -1.0, 1.0))
    weight = np.exp(-0.5 * (angle / WIDTH_RAD) ** 2)
    return np.asarray(maps, np.float64) @ (weight / weight.sum(axis=1, keepdims=True)).T


def _directions() -> np.ndarray:
    """(64, 3) unit vectors even on the sphere, by the golden angle."""
    i = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * i / DIRECTIONS, np.pi * (3.0 - np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def spread_points(points: np.ndarray, count: int) -> np.ndarray:
    """Places (min(count, N),) of points (N, 2) that are far from one another, the one nearest to the middle first."""
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or count < 1:
        raise ShapeError(f"points has shape {points.shape}, count is {count}; expected (N, 2) and at least 1.")
    start = int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())
    return farthest_points(points, min(count, len(points)), start=start)


def hands_of(book: CodeBook, rows: Sequence[int] | np.ndarray) -> tuple[str, ...]:
    """The hand of each row."""
    return tuple(book.hands[i] for i in book.hand_index[np.asarray(rows, np.int64)])
