import numpy as np
import pytest

from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.evaluate.denoise import correction_gain
from neuralgrasps.model.kinematic_field import KinematicField


def field_with(run, decoder) -> KinematicField:
    field = run.field
    return KinematicField(
        hands=field.hands, objects=field.objects, hand_codecs=field.hand_codecs, object_codecs=field.object_codecs,
        decoder=decoder,
    )  # fmt: skip


def test_the_network_helps_on_unseen_grasps(small_run, small_dataset) -> None:
    slight, strong = correction_gain(small_run.field, small_dataset, levels=(0.02, 0.3))
    assert strong.grasps == 8 and strong.level == 0.3
    assert strong.network_mm < 0.98 * strong.closed_form_mm
    assert slight.network_mm < 1.01 * slight.closed_form_mm


def test_without_a_network_nothing_is_gained(small_run, small_dataset) -> None:
    (score,) = correction_gain(field_with(small_run, None), small_dataset, levels=(0.3,))
    assert score.network_mm == score.closed_form_mm > 10.0


def test_the_closed_form_error_follows_the_noise_and_draws_repeat(small_run, small_dataset) -> None:
    scores = correction_gain(small_run.field, small_dataset, levels=(0.001, 0.002), seed=3)
    assert scores[1].closed_form_mm == pytest.approx(2.0 * scores[0].closed_form_mm, rel=0.02)
    assert scores == correction_gain(small_run.field, small_dataset, levels=(0.001, 0.002), seed=3)
    assert scores != correction_gain(small_run.field, small_dataset, levels=(0.001, 0.002), seed=4)


def test_one_pair_alone_and_all_together(small_run, small_dataset) -> None:
    def error(**chosen: str) -> float:
        return correction_gain(small_run.field, small_dataset, levels=(0.2,), **chosen)[0].network_mm

    pairs = [error(hand=h, object_name=o) for h, o in small_dataset.pairs]
    assert error() == pytest.approx(np.mean(pairs))  # two test grasps each
    with pytest.raises(UnknownNameError, match="'fetc'"):
        error(hand="fetc")
    with pytest.raises(InputError, match="levels above 0"):
        correction_gain(small_run.field, small_dataset, levels=(0.0,))
