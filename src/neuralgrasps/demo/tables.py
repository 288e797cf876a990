"""The demo's tables: what was measured, what it means and how."""

from __future__ import annotations

import numpy as np

from neuralgrasps.demo.data import DemoData
from neuralgrasps.evaluate.published import PUBLISHED_CHAMFER, plain_name
from neuralgrasps.evaluate.reconstruction import HandReconstruction, ObjectReconstruction
from neuralgrasps.report.content import Histogram, ModelRow, SynthesisRow, Table


def _plain(name: str) -> str:
    return plain_name(name).replace("_", " ")


def synthesis_rows(data: DemoData) -> tuple[SynthesisRow, ...]:
    rows = []
    for record in data.records:
        pair = (record.hand, record.object)
        depth = data.grasps.by_pair.get(pair, np.zeros(0))
        rows.append(
            SynthesisRow(
                hand=record.hand,
                object=record.object,
                candidates=record.proposals,
                valid=record.valid,
                tried=record.tried,
                validated=record.validated,
                success_share=record.physics_success if record.tried else None,
                penetration_p95_mm=float(np.percentile(depth, 95) * 1e3) if len(depth) else None,
                epsilon_median=float(np.median(data.set_of(*pair).epsilon)) if len(depth) else None,
                cpu_s=record.cpu_s,
            )
        )
    return tuple(rows)


def model_rows(data: DemoData) -> tuple[ModelRow, ...]:
    return tuple(
        ModelRow(
            object=s.object,
            grasps=s.one_view.queries,
            hand_error_mm=s.mean_error_m("complete") * 1e3,
            object_error_mm=s.shape.surface.mean_m * 1e3,
            near_code=s.one_view.near_z,
            near_contact=s.one_view.near_gt,
            far_code=s.one_view.far_z,
            far_contact=s.one_view.far_gt,
            is_scan=data.are_scans,
            chamfer_e3=float(np.mean([p.complete.chamfer for p in s.pairs]) * 1e3),
            chamfer_oracle_e3=float(np.mean([p.complete.oracle for p in s.pairs]) * 1e3),
        )
        for s in data.latent.objects
    )


def paper_table(data: DemoData) -> Table:
    """Table 1 of the paper: the published Chamfer per shape, ours / a perfect field's / the paper's."""
    shapes = ("object", *data.hands)
    rows = []
    for s in data.latent.objects:
        scores: dict[str, HandReconstruction | ObjectReconstruction] = {p.hand: p.complete for p in s.pairs}
        scores["object"] = s.shape
        published = PUBLISHED_CHAMFER.get(plain_name(s.object), {}) if data.are_scans else {}
        cells = []
        for shape in shapes:
            score, paper = scores.get(shape), published.get(shape)
            ours = f"{score.chamfer * 1e3:.2f} / {score.oracle * 1e3:.2f}" if score else "–"
            cells.append(f"{ours} / {paper:.2f}" if paper is not None else ours)
        rows.append((_plain(s.object), *cells))
    return Table(
        title="The paper's Table 1: Chamfer × 10⁻³, ours / a perfect field's / the paper's",
        columns=("object", *shapes),
        rows=tuple(rows),
        meaning="The published measure compares a filled shape with a surface, so a perfect field does not score 0, "
        "and a smaller number than its own is no better. Ours decode exact solids, so they meet the perfect field's. "
        "The paper's figures are for its own grasps and learned shapes; the hands' models differ too.",
        how="Unseen grasps, inferred from 1,024 unlabelled surface points (the paper: from signed distances); 100,000 "
        "queries.",
    )


def inference_table(data: DemoData) -> Table:
    """How well held-out grasps are found, by how much of the hand is seen."""
    kinds = ("known", "complete", "one_view")
    rows = []
    for s in data.latent.objects:
        errors = [round(s.mean_error_m(kind) * 1e3, 4) for kind in kinds]
        worst = max(p.one_view.p95_m for p in s.pairs) * 1e3
        rows.append((_plain(s.object), s.known.queries, *errors, worst, *(getattr(s, kind).gap for kind in kinds)))
    gaps = ("gap, known", "gap, all points", "gap, one view")
    return Table(
        title="Held-out grasps, by what is seen of the hand",
        columns=("object", "grasps", "known mm", "all points mm", "one view mm", "one view p95 mm", *gaps),
        rows=tuple(rows),
        meaning="Known: pose and joints are given and the code keeps them, so the error is rounding and the gap is "
        "what 96 cells lose of 2,048 contact points. All points: 1,024 unlabelled points all over the hand, no noise. "
        "One view: the points one depth camera sees, behind the object or the hand itself none, 1 mm noise. Hand and "
        "object pose are known.",
        how="Mean two-sided distance between the true and the found hand's surfaces; p95 of the worst hand. The gap "
        "is the contact similarity lost against the best neighbour in the gallery. Training never saw these grasps.",
    )


def correction_table(data: DemoData) -> Table:
    """What the trained network gains."""
    return Table(
        title="What training adds",
        columns=("code off by", "grasps", "decoded as it is, mm", "corrected by the network, mm"),
        rows=tuple((f"{c.level:g}", c.grasps, c.closed_form_mm, c.network_mm) for c in data.latent.correction),
        meaning="Held-out codes are made wrong by a known amount (0.1 is 1 cm, 0.1 rad and 5 % of a joint's range) "
        "and decoded. Nothing else on this page uses the network: codes, retrieval and the fits above need no "
        "training.",
        how="Mean distance between corresponding points of the true and the decoded hand.",
    )


def pose_table(data: DemoData) -> Table:
    rows = []
    for name in data.objects:
        trials = [t for t in data.poses if t.object == name]
        add_s = np.array([t.errors.add_s_m for t in trials]) * 1e3
        turn = np.rad2deg([t.errors.rotation_rad for t in trials])
        shift = np.array([t.errors.translation_m for t in trials]) * 1e3
        wall = np.array([t.wall_s for t in trials])
        good = np.mean([t.errors.mssd_m < 0.1 * t.diameter_m for t in trials])
        medians = (float(np.median(a)) for a in (add_s, turn, shift, wall))
        row: tuple[str | float | int | None, ...] = (_plain(name), len(trials), *medians, float(good))
        rows.append(row)
    return Table(
        title="Object pose from one depth view",
        columns=("object", "views", "ADD-S mm", "rotation deg", "translation mm", "seconds", "MSSD < 0.1 d"),
        rows=tuple(rows),
        meaning="Medians; errors modulo the object's symmetry. The object stands on a table in a random stable pose, "
        "seen from 0.5 to 1.2 m with simulated sensor noise, cut out by the table's height. Easy views: nothing hides "
        "the object.",
        how="Found from the points and the free space in the depth image by 2,000 starts on the signed distance; "
        "one thread.",
    )


def dataset_facts(data: DemoData) -> tuple[tuple[str, str], ...]:
    manifest = data.dataset.manifest
    scenes = sum(s.scenes for s in manifest.shards)
    queries = manifest.config.queries_per_scene
    return (
        ("scenes (one hand on one object)", f"{scenes}"),
        (
            "signed distances",
            f"{scenes * queries:,} query points, from the mesh and the hand's solids",
        ),
        ("contact maps", f"{scenes} maps of 2,048 surface points"),
        ("split", "one in six grasps is held out for testing; training never sees it"),
        ("folder", f"{data.config.out / 'dataset'}: manifest with checksums, safetensors shards"),
    )


def histograms(data: DemoData) -> tuple[Histogram, ...]:
    depth: dict[str, list[np.ndarray]] = {}
    for (hand, _), values in data.grasps.by_pair.items():
        depth.setdefault(hand, []).append(values * 1e3)
    return (
        Histogram(
            title="Overlap of hand and object", unit="mm", limit=1.0,
            values={hand: np.concatenate(v) for hand, v in depth.items()},
            meaning="How deep hand and true mesh cut into each other, points every 2 mm on both, one value per grasp.",
        ),
    )  # fmt: skip
