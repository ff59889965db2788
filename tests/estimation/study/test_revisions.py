"""Revisions in their folder: concurrent writers, and invalid files."""

import json
import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from palpate.estimation.study import Revisions
from palpate.estimation.study.saved_diagnosis import with_checksum
from palpate.robot_io.errors import InputError
from tests.revisions import SPRING, revision


@pytest.mark.parametrize("links", [True, False])
def test_concurrent_writes_are_all_preserved(links, tmp_path, monkeypatch):
    if not links:

        def refuse(*_):
            raise PermissionError(1, "no links")

        monkeypatch.setattr(os, "link", refuse)
    with ThreadPoolExecutor(8) as pool:
        errors = [float(error) for error in range(24)]
        kept = list(pool.map(lambda rmse: Revisions(tmp_path).save(lambda n: revision(n, rmse)), errors))
    assert sorted(one.number for one in kept) == list(range(24))
    assert list(Revisions(tmp_path).all()) == sorted(kept, key=lambda one: one.number)
    assert {one.rmse for one in Revisions(tmp_path).all()} == set(errors)
    assert len(list((tmp_path / "revisions").iterdir())) == 24


def test_revisions_without_a_folder_stay_in_memory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kept = Revisions(None)
    assert [kept.save(revision).number for _ in range(2)] == [0, 1]
    assert kept.get(1) == revision(1)
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"no revision 7 in memory\. Available: 0, 1"):
        kept.get(7)


def test_only_revision_files_are_read(tmp_path):
    kept = Revisions(tmp_path).save(revision)
    for name in ("1.json", "00001.json", "²222.json", "0001.json.json"):
        (tmp_path / "revisions" / name).write_text("nonsense")
    assert Revisions(tmp_path).all() == (kept,)


def test_named_pipe_is_not_read(tmp_path):
    (tmp_path / "revisions").mkdir()
    os.mkfifo(tmp_path / "revisions" / "0002.json")
    with pytest.raises(InputError, match=r"0002\.json: is damaged: it is not a regular file"):
        Revisions(tmp_path).all()


STIFFNESS = {"std_err": None, "unit": "N/m"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"effects": ["bias"]}, "its effects are bias"),
        ({"effects": ["bias"], "removed": "bias"}, "its effects are bias"),
        ({"number": 7}, "its number is 7"),
        ({"added": "magic"}, "it added 'magic'"),
        ({"number": -1}, "number"),
        ({"number": 10**9}, "number"),
        ({"parent": 7}, "parent is 7"),
        ({"rmse": -1.0}, "rmse"),
        ({"rmse": 1e300}, "rmse"),
        ({"rmse": "NaN"}, "rmse"),
        ({"model": "spring"}, "no model is called 'spring'"),
        ({"effects": ["cubic_stiffness", "cubic_stiffness"]}, "its effects are"),
        ({"parameters": {}}, r"damping\.c is missing"),
        ({"parameters": {"stiffness.k": STIFFNESS | {"value": 1e300}}}, r"parameters\.stiffness\.k\.value"),
        ({"parameters": {"stiffness.k": STIFFNESS | {"value": 1.0, "std_err": -2.0}}}, "std_err"),
    ],
)
def test_edited_revision_with_invalid_values_is_refused(changes, said, tmp_path):
    kept = Revisions(tmp_path).save(revision)
    file = tmp_path / "revisions" / "0000.json"
    file.write_text(json.dumps(with_checksum(kept.model_dump(mode="json") | changes)))
    with pytest.raises(InputError, match=rf"0000\.json: is damaged: .*{said}"):
        Revisions(tmp_path).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda content: content | {"rmse": 1.0000001}, "changed after palpate wrote it"),
        (lambda content: {key: value for key, value in content.items() if key != "sha256"}, "is missing"),
    ],
)
def test_edited_plausible_value_is_refused(change, said, tmp_path):
    kept = Revisions(tmp_path)
    made = kept.save(revision)
    assert kept.all() == (made,)
    file = tmp_path / "revisions" / "0000.json"
    file.write_text(json.dumps(change(json.loads(file.read_text()))))
    with pytest.raises(InputError, match=rf"0000\.json: is damaged: sha256: .*{said}"):
        kept.all()


def test_value_beyond_its_physical_bounds_is_refused(tmp_path):
    lag = {"lag.tau": {"value": -5.0, "std_err": None, "unit": "s"}}
    Revisions(tmp_path).save(
        lambda number: revision(number, effects=["lag"], added="lag", parameters=SPRING | lag)
    )
    with pytest.raises(InputError, match=r"lag\.tau is -5, outside"):
        Revisions(tmp_path).all()


def test_several_stages_are_saved_atomically(tmp_path):
    kept = Revisions(tmp_path)
    first, second = kept.save(revision), kept.save(revision)
    kept.discard([second])
    assert kept.all() == (first,)


@pytest.mark.parametrize("names", [("tilt",), ("pitch", "roll")])
def test_tilt_of_each_kind_of_arm_can_be_read_again(names, tmp_path):
    tilt = {f"gravity_tilt.{name}": {"value": 0.1, "std_err": None, "unit": "rad"} for name in names}
    told = {"channel": "joint_1", "model": "rigid_body", "effects": ["gravity_tilt"], "parameters": tilt}
    kept = Revisions(tmp_path).save(lambda number: revision(number, added="gravity_tilt", **told))
    assert Revisions(tmp_path).all() == (kept,)
