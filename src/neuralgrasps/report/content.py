"""What a report holds: plain records of pictures and numbers. Fill a `DemoReport` and give it to `write_report`.

Pictures are uint8 arrays (h, w, 3) or (h, w, 4) as `report.figures` makes them. A number that was not measured is None
and shows as a dash. An empty section is left out of the page. Texts are plain; the page escapes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.report.demonstration_content import DemonstrationFigure
from neuralgrasps.report.transfer_content import TransferList


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFigure:
    """One large number at the top: `value` with its unit ("96 %"), `label` below it, `note` small under both."""

    value: str
    label: str
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFigure:
    """One hand: name, picture, and a line such as "16 joints, 4 fingers"."""

    hand: str
    image: np.ndarray
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspFigure:
    """One grasp: picture and what was proven about it.

    Attributes:
        hand, object: names.
        image: from `render_grasp`.
        epsilon: largest disturbance the grasp resists in every direction (wrench-space ball).
        penetration_mm: deepest overlap of hand and object.
        success: held in the physics trial; None when it was not run.
        displacement_mm: how far the object moved in the hand during the trial.
        kind: what touches, such as "precision, 3 fingers".
        note: anything else, one short line.
    """

    hand: str
    object: str
    image: np.ndarray
    epsilon: float | None = None
    penetration_mm: float | None = None
    success: bool | None = None
    displacement_mm: float | None = None
    kind: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSheet:
    """Diverse grasps of one hand on one object, drawn side by side; `text`: a line of figures of the whole set."""

    hand: str
    object: str
    grasps: tuple[GraspFigure, ...]
    text: str = ""

    def with_text(self, text: str) -> ContactSheet:
        return replace(self, text=text)


@dataclass(frozen=True, slots=True, kw_only=True)
class FeasibilityCell:
    """What one hand can do with one object.

    Attributes:
        value: such as "60 of 60"; notes: lines under it, such as "97 % held".
        problem: why there are none, in two or three words; "" when there are some. reason: the same with its numbers.
    """

    hand: str
    object: str
    value: str
    notes: tuple[str, ...] = ()
    problem: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeasibilityFigure:
    """Every hand on every object. `hands`, `objects`: name -> picture; a pair without a cell shows a dash."""

    hands: dict[str, np.ndarray]
    objects: dict[str, np.ndarray]
    cells: tuple[FeasibilityCell, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactFigure:
    """A contact map drawn on the object. `area_share`: share of the surface within 4 mm of the hand, 0..1."""

    hand: str
    object: str
    image: np.ndarray
    area_share: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbour:
    """A grasp in a retrieval row; `similarity` of its contact map to the query's, 0..1."""

    hand: str
    image: np.ndarray
    similarity: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrievalRow:
    """A query grasp, the nearest grasp of each hand by latent code, and the farthest of all."""

    object: str
    query: Neighbour
    nearest: tuple[Neighbour, ...]
    farthest: Neighbour | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferFigure:
    """A grasp of one hand carried over to another: both pictures and one or two sentences."""

    object: str
    source: Neighbour
    target: Neighbour
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentMap:
    """A t-SNE of latent codes.

    Attributes:
        points: (N, 2); hands: of each point; notes: shown on hover, one per point or none.
        unseen: points of grasps that training never saw, drawn as outlines.
        pictures: point -> picture of its grasp, shown beside the plot; those points carry letters.
    """

    title: str
    points: np.ndarray
    hands: tuple[str, ...]
    notes: tuple[str, ...] = ()
    text: str = ""
    unseen: tuple[int, ...] = ()
    pictures: Mapping[int, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFigure:
    """An object's pose found in a depth image.

    Attributes:
        object: name.
        observed: what the camera saw, from `render_relief` (or a colour image).
        overlay: from `render_pose_overlay`.
        rotation_error_deg: modulo the object's symmetries; translation_error_mm; add_s_mm: mean closest-point error.
        wall_s: time to find it.
    """

    object: str
    observed: np.ndarray
    overlay: np.ndarray
    rotation_error_deg: float | None = None
    translation_error_mm: float | None = None
    add_s_mm: float | None = None
    wall_s: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundObject:
    """One object found in a frame.

    Attributes:
        colour: "#rrggbb" of its lines in the picture.
        confidence: probability that the pose is right, 0..1.
        position_m, quaternion_wxyz: its frame in the camera frame.
        residual_mm: median distance of the measured points to the model; explained_share: of them that lie on it.
        position_sigma_mm, rotation_sigma_deg: one standard deviation in the least certain direction.
        others: what other poses fit, in words.
    """

    object: str
    colour: str
    confidence: float
    position_m: tuple[float, ...]
    quaternion_wxyz: tuple[float, ...]
    residual_mm: float | None = None
    explained_share: float | None = None
    position_sigma_mm: float | None = None
    rotation_sigma_deg: float | None = None
    others: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFigure:
    """One depth frame and what was found in it.

    Attributes:
        name: of the frame.
        overlay: from `render_pose_overlay`; observed: its depth, from `render_relief`.
        missing: objects that were looked for and not found.
        note: anything else, such as the table or why nothing could be looked for. wall_s: time to find all.
    """

    name: str
    overlay: np.ndarray
    observed: np.ndarray
    found: tuple[FoundObject, ...] = ()
    missing: tuple[str, ...] = ()
    note: str = ""
    wall_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutionFigure:
    """One trial of picking an object up.

    Attributes:
        title: the object and the trial's number; success: lifted at the first attempt; retry: at a later one.
        cause: why not at the first, "" otherwise; detail: in words.
        pictures: captions and pictures, in the order of what happened.
        animation: a WebP that moves, or b"".
        facts: names and values in a line.
    """

    title: str
    success: bool
    retry: bool = False
    cause: str = ""
    detail: str = ""
    pictures: tuple[tuple[str, np.ndarray], ...] = ()
    animation: bytes = b""
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthesisRow:
    """One hand x object of the synthesis: counts, quality of the kept grasps, and cost.

    Attributes:
        candidates: start poses. valid: of them, grasps that passed every geometric test.
        tried: grasps put to the physics trial (from `validated` and `success_share` when None). validated: held.
        success_share: validated / tried, 0..1.
    """

    hand: str
    object: str
    candidates: int
    valid: int
    validated: int
    tried: int | None = None
    success_share: float | None = None
    penetration_p95_mm: float | None = None
    epsilon_median: float | None = None
    cpu_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelRow:
    """Measured quality of the latent model on one object's held-out grasps.

    Attributes:
        object: name without the YCB number ("cracker_box"); the paper's numbers are found by it.
        hand_error_mm, object_error_mm: mean two-sided surface distance of the reconstruction.
        near_code, near_contact, far_code, far_contact: contact similarity of the nearest and farthest neighbour,
            found by code and by the contact maps themselves (the best any code could do).
        chamfer_e3, chamfer_oracle_e3: the published Chamfer measure, x 1e-3: ours, and a perfect reconstruction's.
        is_scan: the object is a real scan, so the published figures of its name belong beside it.
    """

    object: str
    grasps: int
    hand_error_mm: float | None = None
    object_error_mm: float | None = None
    near_code: float | None = None
    near_contact: float | None = None
    far_code: float | None = None
    far_contact: float | None = None
    chamfer_e3: float | None = None
    chamfer_oracle_e3: float | None = None
    is_scan: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class StageTime:
    """Cost of one stage of the run."""

    stage: str
    wall_s: float
    cpu_s: float | None = None
    peak_memory_mib: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Any other table. `rows` hold strings, numbers or None; a column of numbers is aligned right.

    Attributes:
        meaning: what the numbers mean, one or two sentences; how: how they were measured.
        strong_rows: indices of rows to emphasise (totals).
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float | int | None, ...], ...]
    meaning: str = ""
    how: str = ""
    strong_rows: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """A text to be copied, line by line as it is; `meaning`: what to do with it."""

    title: str
    text: str
    meaning: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Distribution of one measured number, optionally apart by hand.

    Attributes:
        values: hand (or any group) -> (N,) values. limit: a line drawn at the accepted bound, or None.
    """

    title: str
    unit: str
    values: dict[str, np.ndarray]
    limit: float | None = None
    meaning: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoReport:
    """One run of the demo, everything its page shows. Only `title` and `command` are required.

    `parts` are other reports, each shown as one section: its title, subtitle and sections.
    """

    title: str
    command: str
    subtitle: str = ""
    machine: str = ""
    seed: int | None = None
    version: str = ""
    created: str = ""
    key_figures: tuple[KeyFigure, ...] = ()
    hands: tuple[HandFigure, ...] = ()
    demonstration: DemonstrationFigure | None = None
    transferred: tuple[TransferList, ...] = ()
    feasibility: FeasibilityFigure | None = None
    sheets: tuple[ContactSheet, ...] = ()
    grasps: tuple[GraspFigure, ...] = ()
    contacts: tuple[ContactFigure, ...] = ()
    retrieval: tuple[RetrievalRow, ...] = ()
    transfers: tuple[TransferFigure, ...] = ()
    latent_maps: tuple[LatentMap, ...] = ()
    poses: tuple[PoseFigure, ...] = ()
    frames: tuple[FrameFigure, ...] = ()
    executions: tuple[ExecutionFigure, ...] = ()
    parts: tuple[DemoReport, ...] = ()
    synthesis: tuple[SynthesisRow, ...] = ()
    dataset: tuple[tuple[str, str], ...] = ()
    model: tuple[ModelRow, ...] = ()
    times: tuple[StageTime, ...] = ()
    tables: tuple[Table, ...] = ()
    histograms: tuple[Histogram, ...] = ()
    listings: tuple[Listing, ...] = ()
    notes: tuple[str, ...] = ()
    section_texts: dict[str, str] = field(default_factory=dict)
    section_titles: dict[str, str] = field(default_factory=dict)
