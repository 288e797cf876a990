import numpy as np
import pytest

from neuralgrasps.grasps.kind import contact_kinds
from neuralgrasps.hands.zoo import hand_names, load_hand


def _tips(hand):
    solid = {part.link for part in hand.parts}
    return [[link for link in f.links if link in solid][-1] for f in hand.fingers]


@pytest.mark.parametrize("name", hand_names())
def test_fingertips_alone_are_a_precision_grasp(name):
    hand = load_hand(name)
    links = np.array([[*_tips(hand), -1, -1]])
    kinds = contact_kinds(hand, links)
    assert kinds.precision.tolist() == [True]
    assert kinds.palm_contact.tolist() == [False]
    assert kinds.finger_count.tolist() == [len(hand.fingers)]


@pytest.mark.parametrize("name", hand_names())
def test_the_palm_makes_a_power_grasp(name):
    hand = load_hand(name)
    kinds = contact_kinds(hand, np.array([[0, *_tips(hand)]]))
    assert kinds.palm_contact.tolist() == [True]
    assert kinds.precision.tolist() == [False]


@pytest.mark.parametrize("name", ("allegro", "barrett", "human"))
def test_an_inner_phalanx_makes_a_power_grasp_without_the_palm(name):
    hand = load_hand(name)
    solid = {part.link for part in hand.parts}
    finger = hand.fingers[0]
    inner = next(link for link in finger.links if link in solid)
    kinds = contact_kinds(hand, np.array([[inner, _tips(hand)[1]]]))
    assert kinds.precision.tolist() == [False]
    assert kinds.palm_contact.tolist() == [False]
    assert kinds.finger_count.tolist() == [2]


def test_several_contacts_of_a_finger_count_once_and_none_is_no_grasp():
    hand = load_hand("allegro")
    tips = _tips(hand)
    kinds = contact_kinds(hand, np.array([[tips[0], tips[0], tips[1]], [-1, -1, -1]]))
    assert kinds.finger_count.tolist() == [2, 0]
    assert kinds.precision.tolist() == [True, False]
