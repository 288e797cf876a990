"""The default grasp field: a code decodes to a wrist pose and joints; the hand's distance is then exact.

One field serves all hands and objects. With `noise_level` 0 decoding is the closed-form inverse of
encoding. With a positive level the code is taken to be off by about that much (an observed or sampled code),
and a network trained on known grasps moves it back towards them; the correction shrinks with the level, so both
cases are one function. Hands and objects outside the training set decode in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.dataset.samples import contact_maps, normalisation_of
from neuralgrasps.errors import InputError, ShapeError, unknown_name
from neuralgrasps.geometry.rotation import matrix_from_6d
from neuralgrasps.geometry.sdf_grid import query_grid
from neuralgrasps.geometry.se3 import make_transform
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.signed_distance import hand_signed_distance
from neuralgrasps.model.codes import (
    CELLS,
    CODE_SIZE,
    PALM,
    PALM_UNIT_M,
    CodeBook,
    HandCodec,
    ObjectCodec,
    assemble_codes,
    contact_blocks,
    hand_codec,
    object_codec,
)
from neuralgrasps.model.decoder import Decoder, cell_tensors, corrected_blocks
from neuralgrasps.model.field import FieldOutput
from neuralgrasps.objects.object_model import ObjectModel

CONTACT_DECAY = 0.05  # of an object outside any dataset, in its normalised units
POINT_SPACING_M = 0.006


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedGrasps:
    """Grasps that codes decode to.

    Attributes:
        X_OH: (N, 4, 4) hand base in the object frame, metres; q: (N, J) joints within their limits.
    """

    X_OH: Tensor
    q: Tensor


class KinematicField:
    """`GraspField` over any number of hands and objects.

    Attributes:
        hands, objects: models by name; hand_codecs, object_codecs, packed: what belongs to them.
        decoder: the trained correction, or None (closed-form decoding only).
    """

    def __init__(
        self,
        *,
        hands: Mapping[str, Hand],
        objects: Mapping[str, ObjectModel],
        hand_codecs: Mapping[str, HandCodec] | None = None,
        object_codecs: Mapping[str, ObjectCodec] | None = None,
        decoder: Decoder | None = None,
    ) -> None:
        self.hands = dict(hands)
        self.objects = dict(objects)
        given_hands, given_objects = dict(hand_codecs or {}), dict(object_codecs or {})
        self.hand_codecs = {n: given_hands.get(n) or hand_codec(h) for n, h in self.hands.items()}
        self.object_codecs = {n: given_objects.get(n) or default_object_codec(o) for n, o in self.objects.items()}
        self.packed: dict[str, PackedHand] = {n: pack_hand(h, spacing=POINT_SPACING_M) for n, h in self.hands.items()}
        self.decoder = decoder

    def hand(self, name: str) -> Hand:
        if name not in self.hands:
            raise unknown_name("hand", name, self.hands)
        return self.hands[name]

    def object(self, name: str) -> ObjectModel:
        if name not in self.objects:
            raise unknown_name("object", name, self.objects)
        return self.objects[name]

    def encode(self, X_OH: np.ndarray, q: np.ndarray, *, hand: str, object_name: str) -> CodeBook:
        """Codes of known grasps (pose and joints given): computed exactly, nothing is inferred.

        Of hands with more than 23 joints (`HandCodec.is_lossless`) a code keeps the 23 strongest synergies only.

        Args:
            X_OH: (N, 4, 4) hand base in the object frame, metres; q: (N, J) joints.
        """
        self.hand(hand).check_q(q)
        self.object(object_name)
        codec = self.object_codecs[object_name]
        maps = contact_maps(self.packed[hand], X_OH, q, codec.points_O, radius_m=codec.radius_m)
        return self.encode_with_maps(maps, X_OH, q, hand=hand, object_name=object_name)

    def encode_with_maps(
        self, maps: np.ndarray, X_OH: np.ndarray, q: np.ndarray, *, hand: str, object_name: str
    ) -> CodeBook:
        """`encode` when the contact maps (N, P) at the object's contact points are there already."""
        codec = self.object_codecs[object_name]
        count = len(X_OH)
        return CodeBook(
            values=assemble_codes(contact_blocks(maps, codec), X_OH, q, hand=self.hand_codecs[hand], obj=codec),
            hands=(hand,),
            objects=(object_name,),
            hand_index=np.zeros(count, np.int32),
            object_index=np.zeros(count, np.int32),
            grasp_index=np.full(count, -1, np.int32),
            contact_maps=maps,
        )

    def decode(self, codes: Tensor, *, hand: str, object_name: str, noise_level: float | Tensor = 0.0) -> DecodedGrasps:
        """Grasps of codes (N, 128) of one hand and object; differentiable in the codes.

        Args:
            noise_level: how far off the palm and posture blocks may be, in code units (0.1 = 1 cm, 0.1 rad,
                5 % of a joint's range), one for all or (N,); 0 = decode exactly what the code says. Hands that the
                network was not trained on are decoded so at any level.
        Raises:
            ShapeError: the codes are not (N, 128).
        """
        if codes.ndim != 2 or codes.shape[1] != CODE_SIZE:
            raise ShapeError(f"codes have shape {tuple(codes.shape)}; expected (N, {CODE_SIZE}).")
        self.hand(hand)
        self.object(object_name)
        level = torch.as_tensor(noise_level, dtype=codes.dtype, device=codes.device).expand(len(codes))
        if bool((level < 0).any()):
            raise InputError(f"noise_level is {float(level.min())}; expected 0 or more.")
        blocks = codes[:, CELLS:]
        if self.decoder is not None and hand in self.decoder.hands and bool((level > 0).any()):
            decoder = self.decoder.to(codes.device)
            cells = cell_tensors([self.object_codecs[object_name]], dtype=torch.float32, device=codes.device)
            whose = torch.full((len(codes),), decoder.hands.index(hand), device=codes.device)
            moved = corrected_blocks(decoder, codes.float(), cells.expand(len(codes)), level.float(), whose)
            blocks = torch.where(level[:, None] > 0, moved.to(codes.dtype), blocks)
        return decode_blocks(blocks, self.hand_codecs[hand], self.object_codecs[object_name])

    def __call__(
        self, points_O: Tensor, codes: Tensor, *, hand: str, object_name: str, noise_level: float | Tensor = 0.0
    ) -> FieldOutput:
        """Distances at `points_O` (M, 3) or (N, M, 3), metres; see `GraspField`. Exact for the decoded hand; the
        object's distance is its grid's."""
        grasps = self.decode(codes, hand=hand, object_name=object_name, noise_level=noise_level)
        points = points_O.expand(len(codes), *points_O.shape[-2:])
        return FieldOutput(
            sdf_object=query_grid(self.object(object_name).sdf, points),
            sdf_hand=hand_signed_distance(self.hand(hand), grasps.X_OH, grasps.q, points),
        )

    def with_hand(self, hand: Hand) -> KinematicField:
        """A field that also knows `hand`; it needs no training."""
        return self._extended(hands={**self.hands, hand.name: hand}, objects=self.objects)

    def with_object(self, obj: ObjectModel) -> KinematicField:
        """A field that also knows `obj`; it needs no training."""
        return self._extended(hands=self.hands, objects={**self.objects, obj.name: obj})

    def _extended(self, *, hands: Mapping[str, Hand], objects: Mapping[str, ObjectModel]) -> KinematicField:
        return KinematicField(
            hands=hands,
            objects=objects,
            hand_codecs={n: c for n, c in self.hand_codecs.items() if hands.get(n) is self.hands.get(n)},
            object_codecs={n: c for n, c in self.object_codecs.items() if objects.get(n) is self.objects.get(n)},
            decoder=self.decoder,
        )


def default_object_codec(obj: ObjectModel, *, contact_decay: float = CONTACT_DECAY) -> ObjectCodec:
    """The codec of an object outside any dataset; `contact_decay` in its normalised units."""
    frame = normalisation_of(obj.points_O)
    return object_codec(obj.name, obj.points_O, offset_O=frame.offset_O, radius_m=contact_decay * frame.scale_m)


def decode_blocks(blocks: Tensor, hand: HandCodec, obj: ObjectCodec) -> DecodedGrasps:
    """Grasps of palm and posture blocks (N, 32), in closed form."""

    def constant(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=blocks.dtype, device=blocks.device)

    position = constant(obj.offset_O) + PALM_UNIT_M * blocks[:, :3]
    X_OP = make_transform(matrix_from_6d(blocks[:, 3:PALM]), position)
    X_OH = X_OP @ constant(np.linalg.inv(hand.X_HP))
    u = constant(hand.mean) + 0.5 * blocks[:, PALM:] @ constant(hand.basis).T
    q = constant(hand.lower) + u.clamp(0.0, 1.0) * constant(hand.upper - hand.lower)
    return DecodedGrasps(X_OH=X_OH, q=q)
