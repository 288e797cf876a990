"""Fill the report page from what the demo made and measured."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import neuralgrasps
from neuralgrasps.demo.data import DemoData
from neuralgrasps.demo.latent import RetrievalExample
from neuralgrasps.demo.measure import Progress
from neuralgrasps.demo.meter import Meter
from neuralgrasps.demo.pictures import PicturePlan, draw
from neuralgrasps.demo.tables import (
    correction_table,
    dataset_facts,
    histograms,
    inference_table,
    model_rows,
    paper_table,
    pose_table,
    synthesis_rows,
)
from neuralgrasps.parallel import available_cpus
from neuralgrasps.report.content import (
    ContactFigure,
    DemoReport,
    GraspFigure,
    HandFigure,
    KeyFigure,
    Neighbour,
    PoseFigure,
    RetrievalRow,
    StageTime,
)
from neuralgrasps.report.evaluation_page import latent_map
from neuralgrasps.report.execution_page import TRIAL_TEXT
from neuralgrasps.report.page import write_report
from neuralgrasps.report.pose_overlay import TRUE_COLOUR, DrawnModel, render_pose_overlay, render_relief

TOUCH_M = 0.004  # a contact card counts the surface nearer to the hand than this
SHOWN = 3  # grasps shown per hand and object

_PHYSICS = (
    "Each picture is one synthesised grasp, drawn as computed, with the object's true mesh. Held means: in MuJoCo, "
    "the hand closed from its pre-grasp, squeezed within its torque limits, and then kept an object of 0.1 kg "
    "(friction 0.6, torsional friction 0.02 m) while 1 N pulled it along six directions for 2 s each; it may move "
    "less than 5 cm and turn less than 15 degrees (the DexGraspBench protocol; no gravity, the hand's base welded). "
    "ε is the radius of the largest ball of wrenches that the contacts resist; overlap is how deep hand and true "
    "mesh cut into each other; slip is how far the object moved in the trial."
)


_LIFTING = (
    "One trial per object, simulated from the camera to the lift, with the grasps of this page. The scene is drawn at "
    "random among those that a plan exists for."
)


def write_page(data: DemoData, meter: Meter, *, workers: int, progress: Progress) -> Path:
    """Draw every picture and write `report.html`; returns its path."""
    plan = PicturePlan()
    with meter.stage("pictures"):
        hands = [plan.hand(hand) for hand in data.hands]
        shown = [(g.hand, g.object, i) for g in data.grasp_sets for i in range(min(SHOWN, len(g)))]
        grasps = [plan.grasp(*key) for key in shown]
        contacts = [(g.hand, g.object, plan.contact(g.hand, g.object, 0)) for g in data.grasp_sets]
        rows = [(row, [plan.grasp(n.hand, row.object, n.grasp) for n in row.all]) for row in data.latent.retrieval]
        book = data.latent.book
        mapped = {
            int(i): plan.grasp(
                book.hands[book.hand_index[i]], book.objects[book.object_index[i]], int(book.grasp_index[i])
            )
            for m in data.latent.maps_2d
            for i in m.rows[m.pictured]
        }
        pictures = draw(plan, data, workers=workers, progress=progress)
        grasp_figures = tuple(
            _grasp_figure(data, *key, pictures[slot]) for key, slot in zip(shown, grasps, strict=True)
        )
        contact_figures = tuple(
            ContactFigure(
                hand=hand,
                object=obj,
                image=pictures[slot],
                area_share=_touched_share(data, hand, obj),
            )
            for hand, obj, slot in contacts
        )
        hand_figures = tuple(
            HandFigure(
                hand=name,
                image=pictures[slot],
                text=f"{hand.num_dofs} joint{'s' if hand.num_dofs > 1 else ''}, {len(hand.fingers)} fingers",
            )
            for (name, hand), slot in zip(data.hands.items(), hands, strict=True)
        )
        retrieval = tuple(_retrieval_row(row, [pictures[s] for s in slots]) for row, slots in rows)
        poses = _pose_figures(data)
    # the page tells its own cost too, so it is written after its stage was measured
    return write_report(
        DemoReport(
            title="NeuralGrasps: one latent space for every hand",
            command=data.config.command,
            subtitle=f"{len(data.hands)} hands, {len(data.objects)} objects, "
            f"{sum(len(g) for g in data.grasp_sets)} grasps, each held in physics",
            machine=f"{platform.system()} {platform.machine()}, {workers} of {available_cpus()} processors, no GPU",
            seed=data.config.seed,
            version=neuralgrasps.__version__,
            created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            key_figures=_key_figures(data, meter),
            hands=hand_figures,
            grasps=grasp_figures,
            contacts=contact_figures,
            retrieval=retrieval,
            latent_maps=tuple(
                latent_map(m, book, {i: pictures[slot] for i, slot in mapped.items()}) for m in data.latent.maps_2d
            ),
            poses=poses,
            executions=tuple(lift.figure for lift in data.lifts),
            parts=() if data.shown is None else (data.shown.page,),
            synthesis=synthesis_rows(data),
            dataset=dataset_facts(data),
            model=model_rows(data),
            times=tuple(
                StageTime(stage=s.name, wall_s=s.wall_s, cpu_s=s.cpu_s, peak_memory_mib=s.peak_rss_bytes / 2**20)
                for s in meter.stages
            ),
            tables=(inference_table(data), correction_table(data), paper_table(data), pose_table(data)),
            histograms=histograms(data),
            notes=_notes(data),
            section_texts={"grasps": _PHYSICS, "executions": f"{_LIFTING} {TRIAL_TEXT}"},
            section_titles={"executions": "From pose to lifted object"},
        ),
        data.config.out / "report.html",
    )


def _touched_share(data: DemoData, hand: str, obj: str) -> float:
    """Share of the surface within `TOUCH_M` of the hand, for the first grasp of a pair."""
    limit = np.exp(-TOUCH_M / data.dataset.contact_radius_m(obj))
    return float((data.latent.maps[hand, obj][0] >= limit).mean())


def _grasp_figure(data: DemoData, hand: str, obj: str, index: int, image: np.ndarray) -> GraspFigure:
    grasps = data.set_of(hand, obj)[index]
    verdict = grasps.verdicts[grasps.protocol]
    return GraspFigure(
        hand=hand, object=obj, image=image, epsilon=float(grasps.epsilon[0]),
        penetration_mm=float(data.grasps.by_pair[hand, obj][index] * 1e3), success=bool(verdict.success[0]),
        displacement_mm=float(verdict.displacement_m[0] * 1e3),
    )  # fmt: skip


def _retrieval_row(row: RetrievalExample, images: Sequence[np.ndarray]) -> RetrievalRow:
    figures = [Neighbour(hand=n.hand, image=i, similarity=n.similarity) for n, i in zip(row.all, images, strict=True)]
    return RetrievalRow(object=row.object, query=figures[0], nearest=tuple(figures[1:-1]), farthest=figures[-1])


def _key_figures(data: DemoData, meter: Meter) -> tuple[KeyFigure, ...]:
    tried, held = (sum(getattr(r, k) for r in data.records) for k in ("tried", "validated"))
    depth = np.percentile(data.grasps.fine_m, 95) * 1e3
    turn = np.rad2deg(np.median([p.errors.rotation_rad for p in data.poses]))
    return (
        KeyFigure(value=str(held), label="grasps held in physics", note=f"{held / tried:.0%} of {tried} tried"),
        KeyFigure(value=f"{depth:.2f} mm", label="overlap, 95th percentile", note="2 mm points, against the true mesh"),
        KeyFigure(
            value=f"{data.latent.gap('one_view'):.3f}",
            label="retrieval gap",
            note="held-out hands seen in one depth view"
            + (f"; published on these objects: {data.published_gap:.3f}" if data.published_gap is not None else ""),
        ),
        KeyFigure(
            value=f"{turn:.2f}°", label="object rotation error",
            note=f"one depth view, median of {len(data.poses)}",
        ),
        KeyFigure(value=f"{sum(s.wall_s for s in meter.stages):.0f} s", label="for everything on this page"),
    )  # fmt: skip


def _pose_figures(data: DemoData) -> tuple[PoseFigure, ...]:
    figures = []
    for name, obj in data.objects.items():
        trial = next(t for t in data.poses if t.object == name)
        figures.append(
            PoseFigure(
                object=name,
                observed=render_relief(trial.view.depth, trial.view.intrinsics),
                overlay=render_pose_overlay(
                    trial.view.depth,
                    [
                        DrawnModel(mesh=obj.mesh, X_CO=trial.X_CO_true, colour=TRUE_COLOUR, contour_only=True),
                        DrawnModel(mesh=obj.mesh, X_CO=trial.result.X_CO),
                    ],
                    trial.view.intrinsics,
                ),
                rotation_error_deg=float(np.rad2deg(trial.errors.rotation_rad)),
                translation_error_mm=trial.errors.translation_m * 1e3,
                add_s_mm=trial.errors.add_s_m * 1e3,
                wall_s=trial.wall_s,
            )
        )
    return tuple(figures)


def _notes(data: DemoData) -> tuple[str, ...]:
    notes = [
        "The built-in hands are authored from primitives after published dimensions. Fetch, Panda, Barrett and Allegro "
        "agree with their makers' URDFs to 1 mm; the human hand has none to agree with.",
        "Success rates hold for a 0.1 kg object with friction 0.6 and the torque limits of each hand's file; heavier "
        "objects need more. They rest on the torsional friction of 0.02 m: many two-finger grasps slip without it.",
        "Depth images are simulated; real cameras have biases that this sensor model does not contain.",
    ]
    if data.shown is not None:
        notes.append(
            "The demonstration is worked on beside the other stages: its wall time is what was left to wait for, its "
            "processor time is all of it."
        )
    if not data.are_scans:
        notes.append("Objects named after YCB ones are stand-ins of published size unless a mesh file was given.")
    return (*notes, *(f"{r.hand} on {r.object}: {r.reason}." for r in data.records if r.reason))
