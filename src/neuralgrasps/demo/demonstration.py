"""Shown by a hand: a person grasps one of the demo's objects before a depth camera, and a robot does the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from neuralgrasps.apply.demonstrate import DemonstrateConfig, Demonstration, demonstrate
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.demo.execution import ARMED, lift_figure
from neuralgrasps.errors import NeuralGraspsError
from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration
from neuralgrasps.evaluate.execute import ExecuteConfig, Trial
from neuralgrasps.evaluate.execute_bench_trials import robot_of
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.human.video.look import LookConfig
from neuralgrasps.human.video.watch import WatchConfig
from neuralgrasps.model.train_state import torch_threads
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.report.content import DemoReport, ExecutionFigure
from neuralgrasps.report.demonstration_page import DemonstrationStory, demonstration_report
from neuralgrasps.report.sections import pretty_name

TITLE = "Shown by a hand"
_VIDEO = DemonstrationConfig(side="right", still_frames=(6, 8), lift=True)
_WATCH = WatchConfig(look=LookConfig(frames=100))  # every frame, for the film
_GRASPS = 16  # of the robot, so that it reaches one of them
_EVERY_S = 0.04
_HOW = (
    "The video is simulated: a hand of a person's size makes a grasp that held in physics, seen with the noise of a "
    "structured-light camera. From there on nothing is told but the object's model: the object is found and followed, "
    "the hand is found, its joints are read, and the hand model is fitted. The robot's grasps are those of this page, "
    "and new ones near them."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShownByHand:
    """What came of a demonstration.

    Attributes:
        page: its sections. object, hand: names; "" when nothing was shown.
        stage: where it stopped, as the page names it; "" when all is well. reason: why, in words.
        similarity: of the contact maps of the person's grasp and the robot's first; None when there is none.
        lifted: the robot lifted the object; None when it was not tried.
    """

    page: DemoReport
    object: str = ""
    hand: str = ""
    stage: str = ""
    reason: str = ""
    similarity: float | None = None
    lifted: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Watched:
    """A video and what was made of it; none of it where no person's grasp is known."""

    obj: ObjectModel
    reason: str
    frames: Sequence[Frame] = ()
    demo: Demonstration | None = None


def show_by_hand(
    hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel], grasp_sets: Sequence[GraspSet], seed: int
) -> ShownByHand:
    """Record a person's grasp of an object, carry it over to a robot hand, and lift.

    The first object is shown whose grasp is recorded and carried over; the page says what became of those before it.
    Hands with an arm come first; without one, nothing is lifted.

    Args:
        hands, objects: by name. grasp_sets: proven grasps of theirs. seed: of the video and all searches.
    """
    robot = next((n for n in (*ARMED, *hands) if n != "human" and any(g.hand == n for g in grasp_sets)), None)
    if robot is None:
        return _nothing("no robot hand has a grasp of any object.")
    tried: list[_Watched] = []
    for known in (g for g in grasp_sets if g.hand == robot):
        tried.append(_watched(objects[known.object], hands[robot], known, seed))
        if not tried[-1].reason:
            return _carried_out(tried[-1], hands[robot], seed, passed=tried[:-1])
    seen = next((one for one in tried if one.demo is not None), None)
    if seen is not None:
        return _carried_out(seen, hands[robot], seed, passed=[one for one in tried if one is not seen])
    return _nothing("; ".join(f"{pretty_name(one.obj.name)}: {one.reason}" for one in tried))


def _nothing(reason: str) -> ShownByHand:
    page = DemoReport(title=TITLE, command="", subtitle=f"Nothing is shown here: {reason}")
    return ShownByHand(page=page, stage="Video", reason=reason)


def _watched(obj: ObjectModel, hand: Hand, known: GraspSet, seed: int) -> _Watched:
    try:
        frames = record_demonstration(obj, seed=seed, config=_VIDEO).frames
    except NeuralGraspsError as error:  # most often no grasp of a person's; the demo goes on without
        return _Watched(obj=obj, reason=str(error))
    config = DemonstrateConfig(watch=_WATCH, transfer=TransferConfig(count=_GRASPS))
    with torch_threads(1):  # as in a worker: sums depend on the number
        demo = demonstrate(frames, obj, hand, side=_VIDEO.side, known=known, config=config, seed=seed)
    return _Watched(obj=obj, reason=demo.reason if demo.stage else "", frames=frames, demo=demo)


def _carried_out(watched: _Watched, hand: Hand, seed: int, *, passed: Sequence[_Watched]) -> ShownByHand:
    """Lifted where the hand has an arm, and drawn. `passed`: what is not shown."""
    demo, obj = watched.demo, watched.obj
    assert demo is not None
    on_table = demo.table_O is not None  # else there is nowhere to put it before a robot
    robot = robot_of(hand.name, hand.name) if hand.name in ARMED and on_table else None
    trial: Trial | None = None
    card: tuple[ExecutionFigure, ...] = ()
    if robot is not None and not demo.stage:
        config = ExecuteConfig(retries=1, record_every_s=_EVERY_S)
        trial = execute_demonstration(demo, obj, robot, config=config, seed=seed)
        card = (lift_figure(trial, robot),)
    story = DemonstrationStory(
        frames=watched.frames, demo=demo, obj=obj, hand=hand, executed=robot is not None, trial=trial, executions=card
    )
    found, stopped = demo.transfer, next((s for s in story.stages if s.verdict == "failed"), None)
    return ShownByHand(
        page=_page(story, passed),
        object=obj.name,
        hand=hand.name,
        stage="" if stopped is None else stopped.name,
        reason="" if stopped is None else stopped.reason,
        similarity=None if found is None or not len(found.grasps) else float(found.similarity[0]),
        lifted=None if trial is None else trial.success_retry,
    )


def _page(story: DemonstrationStory, passed: Sequence[_Watched]) -> DemoReport:
    """The page of the demonstration without what the demo's page says for itself."""
    page = demonstration_report(story, robot=story.hand.name, command="")
    notes = (f"Not shown: {pretty_name(one.obj.name)}. {one.reason}" for one in passed)
    return replace(
        page, title=TITLE, subtitle=f"{page.subtitle} {_HOW}", notes=(*page.notes, *notes), key_figures=(), times=(),
        tables=(),
    )  # fmt: skip
