"""The tiny hand and box, built once."""

from __future__ import annotations

import pytest

from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel

from .toy import toy_box, toy_hand


@pytest.fixture(scope="session")
def hand() -> Hand:
    return toy_hand(coupled=True)


@pytest.fixture(scope="session")
def box() -> ObjectModel:
    return toy_box()
