"""The `hand.toml` written of a hand gives the same hand back, with nothing left to derive."""

from __future__ import annotations

import tomllib

import pytest

from neuralgrasps.hands.notes_template import hand_toml
from neuralgrasps.hands.zoo import load_hand

from .wild_hands import WILD_HANDS


@pytest.mark.parametrize("name", ["two_slides", "wristed_jaw", "linkage_jaw", "five_fingers", "untidy_claw"])
def test_written_notes_give_the_hand_back(tmp_path, name):
    path = WILD_HANDS[name](tmp_path).path
    derived = load_hand(path)
    path.with_suffix(".toml").write_text(hand_toml(derived), encoding="utf-8")
    stated = load_hand(path)
    for field in ("X_HP", "closing_rate", "q_open", "preshape_lower", "preshape_upper", "jaw_pad_H"):
        assert getattr(stated, field) == pytest.approx(getattr(derived, field), abs=2e-6), field
    assert stated.fingers == derived.fingers and stated.is_jaw == derived.is_jaw
    assert stated.preshape_groups == derived.preshape_groups
    assert stated.tree.effort == pytest.approx(derived.tree.effort, abs=1e-6)
    assert "palm faces" not in stated.extra["annotated"]  # not guessed again


def test_odd_names_are_quoted(tmp_path):
    wild = WILD_HANDS["two_slides"](tmp_path)
    text = wild.path.read_text().replace("left_slide", "left.slide").replace("two_slides", "a 'b' \u00e9")
    wild.path.write_text(text, encoding="utf-8")
    table = tomllib.loads(hand_toml(load_hand(wild.path)))
    assert list(table["joints"]) == ["left.slide"] and table["name"] == "a 'b' \u00e9"
