"""The film of one trial: a title, then every recorded moment with the robot, the hand from near, and what was seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.evaluate.execute import Attempt, Trial
from neuralgrasps.geometry.camera import project
from neuralgrasps.report.film_panel import PANEL_WIDTH, Words, beside, fit, joined, numbered, title_card, words_picture
from neuralgrasps.report.pose_overlay import TRUE_COLOUR, DrawnModel, render_pose_overlay
from neuralgrasps.report.scene import Scene, make_scene
from neuralgrasps.report.scene_painter import ScenePainter, View
from neuralgrasps.report.scene_views import close_direction, close_view, lamp_direction, lit_zone, main_view
from neuralgrasps.report.sections import pretty_name
from neuralgrasps.report.video import FPS

SIZE = (640, 480)  # of the large picture; a column of `PANEL_WIDTH` stands beside it
STEPS = ("look", "move", "approach", "close", "lift", "hold")
_SHOWN_AS = {"start": "look", "open": "move", "transfer": "move"}  # other names of a recording's phases
_SEEN_SHARE, _SEEN_HEIGHT = 0.5, 128  # of what the camera saw: width shown, height in the column
_FOUND_COLOUR = "#ffab3d"  # of the pose that was used, in what the camera saw
_TITLE_S, _LOOK_S, _LAST_S = 1.0, 1.0, 1.2
_METHODS = {"ours": "our pose", "true": "true pose", "baseline": "pose: Eq. 1", "contact": "pose: Eq. 2"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmConfig:
    """How a film runs.

    Attributes:
        speed: of the film over that of the trial; it is written in the frames when it is not 1.
        fps: frames a second. number, total: of the trial, for its title.
    """

    speed: float = 2.0
    fps: int = FPS
    number: int = 0
    total: int = 1


@dataclass(slots=True, kw_only=True, eq=False)
class Film:
    """Draws the moments of one trial; make it with `open_film`.

    Attributes:
        trial: with a recording. scene, painter, view: what is drawn and from where.
        towards: (3,) from the object to the close camera, for each attempt.
        seen: picture (h, w, 3) of what the camera saw at each attempt, None where nothing was looked at.
    """

    trial: Trial
    scene: Scene
    painter: ScenePainter
    view: View
    towards: tuple[np.ndarray, ...]
    seen: tuple[np.ndarray | None, ...]
    _words: dict[Words, np.ndarray] = field(default_factory=dict)

    def moment(self, index: int) -> np.ndarray:
        """The large picture (h, w, 3) of a recorded state."""
        return self._pictures(index)[0]

    def close_up(self, index: int, size: tuple[int, int] = SIZE) -> np.ndarray:
        """The picture from near the hand of a recorded state."""
        q, X_BO = self._state(index)
        lit = self.painter.light(q, X_BO)
        return self.painter.paint(lit, close_view(self.scene, X_BO, self._towards(index), size=size), keep=False)

    def seen_large(self, attempt: int) -> np.ndarray | None:
        """What the camera saw at an attempt, at its own size, with the poses over it."""
        return seen_picture(self.trial, self.trial.attempts[attempt], self.scene.target)

    def frames(self, config: FilmConfig | None = None) -> Iterator[np.ndarray]:
        """All frames (h, w + PANEL_WIDTH, 3) uint8: title, motion, and the last moment with the verdict."""
        config = config or FilmConfig()
        indices = film_indices(self.trial, config)
        looking = self._frame(indices[0], self._words_at(indices[0], config))
        card = title_card(looking, self._title(config))
        for _ in range(round(_TITLE_S * config.fps)):
            yield card
        for _ in range(round(_LOOK_S * config.fps)):
            yield looking
        for index in indices:
            yield self._frame(index, self._words_at(index, config))
        final = self._frame(indices[-1], self._words_at(indices[-1], config, ended=True))
        for _ in range(round(_LAST_S * config.fps)):
            yield final

    def attempt_at(self, index: int) -> int:
        """Number of the attempt that a recorded state belongs to."""
        return int(attempt_numbers(self.trial)[index])

    def _frame(self, index: int, words: Words) -> np.ndarray:
        picture, close = self._pictures(index)
        seen = self.seen[self.attempt_at(index)] if self.seen else None
        if words not in self._words:
            room = picture.shape[0] - len(close) - (0 if seen is None else len(seen))
            self._words = {words: words_picture(words, (PANEL_WIDTH, room))}
        return beside(picture, close, seen, self._words[words])

    def _pictures(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        q, X_BO = self._state(index)
        lit = self.painter.light(q, X_BO)
        close = close_view(self.scene, X_BO, self._towards(index), size=(PANEL_WIDTH, PANEL_WIDTH))
        return self.painter.paint(lit, self.view), self.painter.paint(lit, close, keep=False)

    def _towards(self, index: int) -> np.ndarray:
        return self.towards[self.attempt_at(index)]

    def _state(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        recording = self.trial.recording
        assert recording is not None
        return recording.q[index], recording.X_BO[index]

    def _phases(self) -> list[str]:
        recording = self.trial.recording
        assert recording is not None
        return [_SHOWN_AS.get(name, name) for name in recording.phases]

    def _title(self, config: FilmConfig) -> Words:
        trial = self.trial
        lines = (joined([numbered(config.number, config.total), _robot(trial)]), _METHODS[trial.pose_method])
        return Words(title=pretty_name(trial.object), lines=lines)

    def _words_at(self, index: int, config: FilmConfig, *, ended: bool = False) -> Words:
        recording = self.trial.recording
        assert recording is not None
        number, step = self.attempt_at(index), self._phases()[index]
        again = f"attempt {number + 1}" if number else _robot(self.trial)
        clock = f"{recording.t[index] - recording.t[0]:.1f} s"
        return Words(
            title=pretty_name(self.trial.object),
            lines=(joined([numbered(config.number, config.total), again]), *attempt_lines(self.trial, number)),
            steps=STEPS,
            step=step,
            clock=clock if config.speed == 1 else f"{clock}, {config.speed:g}x speed",
            verdict=verdict_text(self.trial) if ended else "not held" if step == "return" else "",
            good=ended and self.trial.success_retry,
        )


def _robot(trial: Trial) -> str:
    return trial.arm if trial.arm == trial.hand else f"{trial.arm} with {trial.hand}"


def open_film(trial: Trial, manipulator: Manipulator) -> Film:
    """Prepare the drawing of a trial that was recorded.

    Raises:
        ValueError: it has no recording.
    """
    recording = trial.recording
    if recording is None or not len(recording):
        raise ValueError("the trial was not recorded; run it with `record_every_s`.")
    target = next(k for k, placed in enumerate(trial.scene.objects) if placed.obj.name == trial.object)
    objects = [placed.obj for placed in trial.scene.objects]
    scene = make_scene(manipulator, objects, trial.scene.table, target=target)
    key = key_moments(trial)
    moments = [(recording.q[i], recording.X_BO[i]) for i in (0, key["standoff"], key["lift"], key["grasp"])]
    view = main_view(scene, moments, size=SIZE)
    centre, radius = lit_zone(scene)
    grasps = [key_moments(trial, number)["grasp"] for number in range(len(trial.attempts))]
    return Film(
        trial=trial,
        scene=scene,
        painter=ScenePainter(scene, lamp=lamp_direction(view), centre=centre, radius=radius),
        view=view,
        towards=tuple(close_direction(scene, (recording.q[i], recording.X_BO[i])) for i in grasps),
        seen=tuple(_seen(trial, attempt, target) for attempt in trial.attempts),
    )


def attempt_numbers(trial: Trial) -> np.ndarray:
    """(T,) the attempt that each recorded state belongs to; an attempt begins to move by opening its hand."""
    recording = trial.recording
    assert recording is not None
    moved = [k for k, attempt in enumerate(trial.attempts) if attempt.plan is not None] or [0]
    opening = np.array([name == "open" for name in recording.phases])
    begun = np.cumsum(opening & ~np.concatenate([[False], opening[:-1]]))
    return np.array(moved)[np.clip(begun - 1, 0, len(moved) - 1)]


def key_moments(trial: Trial, attempt: int | None = None) -> dict[str, int]:
    """States of an attempt: "standoff", "grasp", "lift"; its last one where it ended early.

    Args:
        attempt: number of one that moved; the first of them when None.
    """
    recording = trial.recording
    assert recording is not None
    numbers = attempt_numbers(trial)[: _last_finite(recording.X_BO) + 1]
    own = numbers == (numbers[0] if attempt is None else attempt)
    own = [i for i in np.flatnonzero(own) if recording.phases[i] != "return"] or [len(numbers) - 1]
    ends = {name: max((i for i in own if recording.phases[i] == name), default=own[-1]) for name in _KEY_PHASES}
    return {shown: int(ends[name]) for name, shown in _KEY_PHASES.items()}


_KEY_PHASES = {"transfer": "standoff", "close": "grasp", "hold": "lift"}


def film_indices(trial: Trial, config: FilmConfig) -> list[int]:
    """States that are shown, one per frame."""
    recording = trial.recording
    assert recording is not None
    last = _last_finite(recording.X_BO)
    t = recording.t[: last + 1]
    wanted = np.arange(t[0], t[-1] + 1e-9, config.speed / config.fps)
    return [int(i) for i in np.clip(np.searchsorted(t, wanted - 1e-6), 0, last)] + [last]


def _last_finite(X_BO: np.ndarray) -> int:
    """The last state before a simulation broke down."""
    finite = np.isfinite(X_BO).all(axis=(1, 2, 3))
    return int(np.argmin(finite)) - 1 if not finite.all() else len(finite) - 1


def verdict_text(trial: Trial) -> str:
    """ "lifted", "lifted at the second attempt", or why not."""
    if trial.success:
        return "lifted"
    return "lifted, 2nd attempt" if trial.success_retry else f"not lifted: {trial.cause}"


def attempt_lines(trial: Trial, number: int) -> list[str]:
    """Where the pose came from and how far it was off, and how long planning took."""
    attempt, method = trial.attempts[number], _METHODS[trial.pose_method]
    if attempt.X_BO_estimate is None:
        return [method, "no pose found"]
    if attempt.frame is not None:
        method = f"{method}: {attempt.pose_error_mm:.1f} mm, {attempt.pose_error_deg:.1f}° off"
    if attempt.plan is None or attempt.pick is None:
        return [method, "no plan"]
    return [method, f"planned in {1e3 * attempt.pick.cpu_s:.0f} ms"]


def _seen(trial: Trial, attempt: Attempt, target: int) -> np.ndarray | None:
    """The part around the object of what the camera saw, for the column."""
    picture = seen_picture(trial, attempt, target)
    if picture is None or attempt.frame is None or attempt.frame.X_WC is None:
        return None
    middle_C = (np.linalg.inv(attempt.frame.X_WC) @ attempt.X_BO_true @ np.append(_middle(trial, target), 1.0))[:3]
    width = min(_SEEN_SHARE * picture.shape[1], picture.shape[1])
    height = min(width * _SEEN_HEIGHT / PANEL_WIDTH, picture.shape[0])
    corner = project(middle_C, attempt.frame.intrinsics) - [width / 2, height / 2]
    left, top = (int(v) for v in np.clip(corner, 0, [picture.shape[1] - width, picture.shape[0] - height]))
    return fit(picture[top : top + int(height), left : left + int(width)], PANEL_WIDTH)


def _middle(trial: Trial, target: int) -> np.ndarray:
    vertices = trial.scene.objects[target].obj.mesh.vertices
    return np.asarray(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))


def seen_picture(trial: Trial, attempt: Attempt, target: int) -> np.ndarray | None:
    """What the camera saw at an attempt, with the true pose in white and the one that was used; None without a look."""
    frame = attempt.frame
    if frame is None or frame.X_WC is None:
        return None
    mesh, X_CB = trial.scene.objects[target].obj.mesh, np.linalg.inv(frame.X_WC)
    models = [DrawnModel(mesh=mesh, X_CO=X_CB @ attempt.X_BO_true, colour=TRUE_COLOUR, contour_only=True)]
    if attempt.X_BO_estimate is not None:
        models.append(DrawnModel(mesh=mesh, X_CO=X_CB @ attempt.X_BO_estimate, colour=_FOUND_COLOUR))
    return render_pose_overlay(frame.depth, models, frame.intrinsics, scale=1)
