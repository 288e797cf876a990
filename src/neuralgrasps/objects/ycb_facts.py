"""Published facts about the YCB objects (Calli et al., IEEE RAM 2015)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

YCB_MASSES_KG: Mapping[str, float] = MappingProxyType(
    {
        "002_master_chef_can": 0.414,
        "003_cracker_box": 0.411,
        "004_sugar_box": 0.514,
        "005_tomato_soup_can": 0.349,
        "006_mustard_bottle": 0.603,
        "007_tuna_fish_can": 0.171,
        "008_pudding_box": 0.187,
        "009_gelatin_box": 0.097,
        "010_potted_meat_can": 0.370,
        "011_banana": 0.066,
        "013_apple": 0.068,
        "014_lemon": 0.029,
        "015_peach": 0.033,
        "016_pear": 0.049,
        "017_orange": 0.047,
        "018_plum": 0.025,
        "021_bleach_cleanser": 1.131,
        "024_bowl": 0.147,
        "025_mug": 0.118,
        "035_power_drill": 0.895,
        "036_wood_block": 0.729,
        "037_scissors": 0.082,
        "040_large_marker": 0.0158,
        "051_large_clamp": 0.125,
        "052_extra_large_clamp": 0.202,
        "061_foam_brick": 0.028,
    }
)
