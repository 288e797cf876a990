from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.dataset.samples import contact_maps
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.model.checkpoint import load_run, run_folder, run_grasps, shipped_runs
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.zoo import load_object

SCANS = (
    "003_cracker_box", "005_tomato_soup_can", "006_mustard_bottle", "008_pudding_box", "009_gelatin_box",
    "010_potted_meat_can", "021_bleach_cleanser",
)  # fmt: skip


@pytest.fixture(scope="module")
def hands() -> dict:
    return {name: load_hand(name) for name in hand_names()}


def test_both_runs_are_there_and_small() -> None:
    assert shipped_runs() == ("standins7", "ycb7")
    for name in shipped_runs():
        size = sum(file.stat().st_size for file in run_folder(name).rglob("*") if file.is_file())
        assert size < 20e6
        assert (run_folder(name) / "README.md").is_file()
    with pytest.raises(InputError, match="standins7, ycb7"):
        run_folder("ycb8")


def test_grasps_of_one_object_need_no_other_and_only_its_own_surface(hands) -> None:
    can = load_object("tomato_soup_can")
    grasps = run_grasps("standins7", hands["fetch"], can)
    assert grasps is not None and (grasps.hand, grasps.object, len(grasps)) == ("fetch", "tomato_soup_can", 60)
    assert run_grasps("ycb7", hands["fetch"], can) is None
    with pytest.raises(InputError, match=r"'tomato_soup_can'.* mm off"):
        run_grasps("standins7", hands["fetch"], replace(load_object("gelatin_box"), name="tomato_soup_can"))


def test_the_run_of_the_stand_ins_is_of_these_hands_and_objects(hands) -> None:
    """Codes, grasps and contact maps belong together, and every grasp is a proven one."""
    run = load_run("standins7")
    assert set(run.field.objects) == set(STAND_INS) and set(run.field.hands) == set(hands)
    assert len(run.grasps) == 35 and all(grasps.validated.all() for grasps in run.grasps.values())
    book = run.codebook
    assert len(book) == 35 * 55 and book.is_test.sum() == 35 * 5
    for (hand, object_name), grasps in list(run.grasps.items())[::6]:
        rows = book[book.where(hand=hand, object_name=object_name)][:2]
        chosen = grasps[rows.grasp_index]
        codec = run.field.object_codecs[object_name]
        maps = contact_maps(run.field.packed[hand], chosen.X_OH, chosen.q, codec.points_O, radius_m=codec.radius_m)
        assert np.abs(maps - rows.contact_maps).max() < 0.5 / 255 + 1e-5
        again = run.field.encode(chosen.X_OH, chosen.q, hand=hand, object_name=object_name)
        assert np.allclose(again.values, rows.values, atol=1e-5)
    for name in book.objects:
        assert score_codebook(book, object_name=name).gap < 0.005


def test_the_run_of_the_scans_refuses_stand_ins(hands, assets: Path) -> None:
    scans = {name: load_object(assets / "ycb" / f"{name}.ply") for name in SCANS}
    run = load_run(run_folder("ycb7"), hands=hands, objects=scans)
    assert set(run.field.objects) == set(SCANS)
    imposter = load_object("mustard_bottle")
    with pytest.raises(InputError, match="not the one that the run was fitted with"):
        load_run(run_folder("ycb7"), hands=hands, objects={**scans, "006_mustard_bottle": imposter})
