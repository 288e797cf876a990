"""The published tables, filled with our figures and set beside the published ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from neuralgrasps.errors import ShapeError
from neuralgrasps.evaluate.reconstruction import HandReconstruction, ObjectReconstruction
from neuralgrasps.evaluate.retrieval import RetrievalScores

# Near Z, Near GT, Far Z, Far GT on unseen grasps: Khargonkar et al. 2022, Table 1.
PUBLISHED_RETRIEVAL: Mapping[str, tuple[float, float, float, float]] = {
    "003_cracker_box": (0.81, 0.88, 0.19, 0.15),
    "005_tomato_soup_can": (0.73, 0.84, 0.13, 0.09),
    "006_mustard_bottle": (0.80, 0.87, 0.14, 0.10),
    "008_pudding_box": (0.77, 0.84, 0.25, 0.16),
    "009_gelatin_box": (0.75, 0.81, 0.22, 0.14),
    "010_potted_meat_can": (0.76, 0.83, 0.21, 0.12),
    "021_bleach_cleanser": (0.86, 0.91, 0.16, 0.13),
}
# Chamfer x 1e-3 on unseen grasps: object, then hands; same source.
PUBLISHED_CHAMFER: Mapping[str, Mapping[str, float]] = {
    "003_cracker_box": {"object": 1.33, "fetch": 1.44, "barrett": 5.52, "human": 2.86, "allegro": 3.03, "panda": 2.48},
    "005_tomato_soup_can": {
        "object": 2.60,
        "fetch": 4.95,
        "barrett": 4.06,
        "human": 3.21,
        "allegro": 3.97,
        "panda": 4.20,
    },
    "006_mustard_bottle": {
        "object": 1.05,
        "fetch": 2.38,
        "barrett": 3.39,
        "human": 2.05,
        "allegro": 2.09,
        "panda": 4.14,
    },
    "008_pudding_box": {"object": 1.49, "fetch": 5.27, "barrett": 8.27, "human": 5.45, "allegro": 3.80, "panda": 5.40},
    "009_gelatin_box": {"object": 1.20, "fetch": 5.42, "barrett": 7.04, "human": 4.72, "allegro": 3.74, "panda": 3.72},
    "010_potted_meat_can": {
        "object": 2.13,
        "fetch": 3.63,
        "barrett": 3.78,
        "human": 3.06,
        "allegro": 4.45,
        "panda": 1.78,
    },
    "021_bleach_cleanser": {
        "object": 7.82,
        "fetch": 2.45,
        "barrett": 5.63,
        "human": 7.22,
        "allegro": 5.41,
        "panda": 14.08,
    },
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A small table of text.

    Attributes:
        title: what it shows and under which conditions.
        header: column names; rows: one text per column.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise ShapeError(f"table '{self.title}': a row has {len(row)} cells; expected {len(self.header)}.")

    def markdown(self) -> str:
        """The table as GitHub-flavoured Markdown."""
        lines = [self.header, ("---",) * len(self.header), *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def retrieval_table(scores: Mapping[str, RetrievalScores], *, title: str) -> Table:
    """Near Z, Near GT, their gap, Far Z, Far GT and recall@1 per object, with the published gap where there is one."""
    rows = []
    for name, s in scores.items():
        published = PUBLISHED_RETRIEVAL.get(name)
        gap = f"{published[1] - published[0]:.2f}" if published else "-"
        figures = (s.near_z, s.near_gt, s.gap, s.far_z, s.far_gt, s.recall_at.get(1, float("nan")))
        rows.append((name, *(f"{v:.3f}" for v in figures), str(s.queries), str(s.gallery), gap))
    names = ("Near Z", "Near GT", "gap", "Far Z", "Far GT", "recall@1", "queries", "gallery", "published gap")
    return Table(title=title, header=("object", *names), rows=tuple(rows))


def reconstruction_table(
    objects: Sequence[ObjectReconstruction], hands: Sequence[HandReconstruction], *, title: str
) -> Table:
    """Per object and hand: the published measure (x 1e-3), its oracle, the published figure, and errors in mm."""
    rows = []
    scores: list[ObjectReconstruction | HandReconstruction] = [*objects, *hands]
    for score in scores:
        who = score.hand if isinstance(score, HandReconstruction) else "object"
        published = PUBLISHED_CHAMFER.get(score.object, {}).get(who)
        rows.append(
            (
                score.object,
                who,
                f"{1e3 * score.chamfer:.2f}",
                f"{1e3 * score.oracle:.2f}",
                "-" if published is None else f"{published:.2f}",
                f"{1e3 * score.surface.mean_m:.3f}",
                f"{1e3 * score.surface.p95_m:.3f}",
            )
        )
    header = ("object", "shape", "Chamfer", "oracle", "published Chamfer", "surface mean mm", "surface p95 mm")
    return Table(title=title, header=header, rows=tuple(sorted(rows)))
