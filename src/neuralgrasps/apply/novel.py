"""Grasps that nobody has seen: sample or interpolate codes, decode, close, and try them in physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.distance import cdist

from neuralgrasps.apply.novel_codes import (
    SampledCodes,
    gaussian_codes,
    kernel_codes,
    midpoint_codes,
    noisy_codes,
)
from neuralgrasps.apply.novel_trial import (
    HELD,
    NOT_HELD,
    NOVEL_OUTCOMES,
    DecodedCodes,
    NovelConfig,
    Trials,
    try_decoded,
)
from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.model.codes import CELLS, CONTACT_BLOCK, CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.seeds import child_seed
from neuralgrasps.synthesis.select import grasp_features


@dataclass(frozen=True, slots=True, kw_only=True)
class NovelResult:
    """What became of N sampled codes.

    Attributes:
        grasps: those that hold, in the order of their codes. code: (G,) int64, which code each came from.
        codes: the sampled codes. outcome: (N,) int8, one of `NOVEL_OUTCOMES`.
        contact_change: (N,) mean absolute difference of the contact blocks of the code and of the closed grasp.
        palm_shift_m, palm_turn_rad: (N,) how far the palm is from where the code put it.
        novelty_m: (N,) distance to the nearest known grasp by palm and joints (`grasp_features`: metres, a turn of 1
            rad counts 5 cm, joints moved over their whole range 5 cm).
        config, seed: how they were made.
    The four distances are nan for codes that did not get to force closure.
    """

    grasps: GraspSet
    code: np.ndarray
    codes: SampledCodes
    outcome: np.ndarray
    contact_change: np.ndarray
    palm_shift_m: np.ndarray
    palm_turn_rad: np.ndarray
    novelty_m: np.ndarray
    config: NovelConfig
    seed: int

    def __repr__(self) -> str:
        ends = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)
        codes = f"{len(self.outcome)} code{'' if len(self.outcome) == 1 else 's'} by {self.config.kind}"
        return f"NovelResult({self.grasps.hand} on {self.grasps.object}: {codes}: {ends})"

    @property
    def counts(self) -> Mapping[str, int]:
        """How many codes ended how."""
        counts = np.bincount(self.outcome, minlength=len(NOVEL_OUTCOMES))
        return dict(zip(NOVEL_OUTCOMES, counts.tolist(), strict=True))

    @property
    def held_share(self) -> float:
        """Share of the codes whose grasp held."""
        return float((self.outcome == HELD).mean())

    @property
    def force_closure_share(self) -> float:
        """Share of the codes that closed to force closure and went into physics."""
        return float((self.outcome >= NOT_HELD).mean())


def novel_grasps(
    field: KinematicField,
    codebook: CodeBook,
    *,
    hand: str,
    object_name: str,
    config: NovelConfig | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> NovelResult:
    """Make codes, decode them, close the hand, and try each grasp once in physics.

    Args:
        field: knows the hand and the object; codebook: known codes of this hand on this object (training codes only are
            used): at least one, or two for midpoints and densities.
        threads: of the physics trials; the result does not depend on it.
        progress: called with (codes closed, codes).
    Raises:
        UnknownNameError: the field does not know the hand or the object.
        InputError: too few known codes. Codes of other hands are of no use here.
    """
    config = config or NovelConfig()
    decoded = decode_novel(field, codebook, hand=hand, object_name=object_name, config=config, seed=seed)
    trials = try_decoded(
        field.hand(hand), field.object(object_name), decoded, config=config, threads=threads, progress=progress
    )
    return judge_novel(field, decoded, trials, config=config, seed=seed)


def decode_novel(
    field: KinematicField, codebook: CodeBook, *, hand: str, object_name: str, config: NovelConfig, seed: int
) -> DecodedCodes:
    """The codes that `config` asks for, decoded; errors as for `novel_grasps`."""
    rows = known_rows(field, codebook, hand=hand, object_name=object_name)
    least = 1 if config.kind == "noise" else 2
    if len(rows) < least:
        raise InputError(
            f"the code book holds {len(rows)} training code of '{hand}' on '{object_name}'; '{config.kind}' needs "
            f"{least}. Add grasps, or sample with noise."
        )
    known = codebook.values[rows].astype(np.float64)
    X_OH, q = decode_hands(field, known, hand=hand, object_name=object_name)
    own_seed = child_seed(seed, "novel", config.kind, hand, object_name)
    sampled = _sample(field, known, X_OH, q, hand=hand, config=config, seed=own_seed)
    places = np.append(rows, -1)
    codes = SampledCodes(values=sampled.values, source=places[sampled.source], neighbour=places[sampled.neighbour])
    new_X_OH, new_q = decode_hands(
        field, codes.values, hand=hand, object_name=object_name, noise_level=config.noise_level
    )
    return DecodedCodes(codes=codes, X_OH=new_X_OH, q=new_q, known_X_OH=X_OH, known_q=q, seed=own_seed)


def judge_novel(
    field: KinematicField, decoded: DecodedCodes, trials: Trials, *, config: NovelConfig, seed: int
) -> NovelResult:
    """The result of trials of decoded codes, with the distances of the grasps to their codes and to known grasps."""
    grasps = trials.grasps
    hand = field.hand(grasps.hand)
    closed = np.flatnonzero(trials.place >= 0)
    change, shift, turn, novelty = (np.full(len(decoded.codes), np.nan) for _ in range(4))
    if len(closed):
        X_OH, q = np.array(grasps.X_OH), np.array(grasps.q)
        again = field.encode(X_OH, q, hand=grasps.hand, object_name=grasps.object).values[:, CONTACT_BLOCK]
        change[closed] = np.abs(again - decoded.codes.values[closed, CONTACT_BLOCK]).mean(axis=1)
        palm, coded = X_OH @ hand.X_HP, decoded.X_OH[closed] @ hand.X_HP
        shift[closed] = np.linalg.norm(palm[:, :3, 3] - coded[:, :3, 3], axis=1)
        cosine = 0.5 * (np.einsum("nij,nij->n", palm[:, :3, :3], coded[:, :3, :3]) - 1.0)
        turn[closed] = np.arccos(np.clip(cosine, -1.0, 1.0))
        known = grasp_features(hand, decoded.known_X_OH, decoded.known_q)
        novelty[closed] = cdist(grasp_features(hand, X_OH, q), known).min(axis=1)
    return NovelResult(
        grasps=grasps[grasps.validated] if len(grasps) else grasps,
        code=np.flatnonzero(trials.outcome == HELD),
        codes=decoded.codes,
        outcome=trials.outcome,
        contact_change=change,
        palm_shift_m=shift,
        palm_turn_rad=turn,
        novelty_m=novelty,
        config=config,
        seed=seed,
    )


def known_rows(field: KinematicField, codebook: CodeBook, *, hand: str, object_name: str) -> np.ndarray:
    """Rows of the training codes of a hand on an object; errors as for `novel_grasps`."""
    field.hand(hand)
    field.object(object_name)
    if codebook.metric_size != CELLS:
        raise InputError("these are free codes of an MlpField, which hold no pose and joints; give a KinematicField's.")
    if hand in codebook.hands and object_name in codebook.objects:
        rows = np.flatnonzero(codebook.where(hand=hand, object_name=object_name, is_test=False))
        if len(rows):
            return rows
    on_it = codebook.where(object_name=object_name) if object_name in codebook.objects else np.zeros(0, np.bool_)
    others = sorted({codebook.hands[i] for i in codebook.hand_index[on_it]}) if on_it.any() else []
    instead = f" Those of {', '.join(others)} cannot stand in: a posture belongs to its hand." if others else ""
    raise InputError(
        f"the code book holds no training grasps of '{hand}' on '{object_name}', and novel ones are made from a hand's "
        f"own.{instead} Synthesise some and train or encode them first."
    )


def decode_hands(
    field: KinematicField, values: np.ndarray, *, hand: str, object_name: str, noise_level: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """X_OH (N, 4, 4), rotations to 1e-12, and q (N, J) of codes (N, 128)."""
    dtype = torch.float64 if noise_level == 0 else torch.float32  # that of the network
    codes = torch.as_tensor(values, dtype=dtype)
    with torch.no_grad():
        out = field.decode(codes, hand=hand, object_name=object_name, noise_level=noise_level)
    X_OH = out.X_OH.double().numpy().copy()
    left, _, right = np.linalg.svd(X_OH[:, :3, :3])
    X_OH[:, :3, :3] = left @ right
    X_OH[:, 3] = (0.0, 0.0, 0.0, 1.0)
    tree = field.hand(hand).tree
    return X_OH, np.clip(out.q.double().numpy(), tree.lower, tree.upper)


def _sample(
    field: KinematicField,
    known: np.ndarray,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    hand: str,
    config: NovelConfig,
    seed: int,
) -> SampledCodes:
    model, count = field.hand(hand), config.count
    if config.kind == "noise":
        return noisy_codes(known, count=count, spread=config.spread, seed=seed)
    if config.kind == "gaussian":
        return gaussian_codes(known, count=count, seed=seed)
    features = grasp_features(model, X_OH, q)
    if config.kind == "midpoint":
        return midpoint_codes(known, features, count=count, seed=seed, share=config.share, is_jaw=model.is_jaw)
    return kernel_codes(known, features, count=count, seed=seed, is_jaw=model.is_jaw)
