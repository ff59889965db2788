"""Revisions in their folder: several programs may write there, and anybody may put things there."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from estimation.study import Revision, Revisions
from estimation.study import revisions as module
from robot_io.errors import InputError


def revision(number, rmse=1.0, **changes):
    spring = {"stiffness.k": {"value": 1.0, "std_err": None, "unit": "N/m"}}
    damper = {"damping.c": {"value": 1.0, "std_err": None, "unit": "N s/m"}}
    told = {"number": number, "parent": None, "channel": "contact", "model": "kelvin_voigt", "added": ""}
    told |= {"effects": [], "user_effects": [], "effort_unit": "N", "rmse": rmse, "noise_floor": 0.5}
    told |= {"parameters": spring | damper, "data_sha256": "", "created_utc": "", "software_version": ""}
    return Revision.model_validate(told | changes)


@pytest.mark.parametrize("links", [True, False])
def test_what_many_write_at_once_is_all_kept(links, tmp_path, monkeypatch):
    if not links:

        def refuse(*_):
            raise PermissionError(1, "no links")

        monkeypatch.setattr(module.os, "link", refuse)
    with ThreadPoolExecutor(8) as pool:
        errors = [float(error) for error in range(24)]
        kept = list(pool.map(lambda rmse: Revisions(tmp_path).keep(lambda n: revision(n, rmse)), errors))
    assert sorted(one.number for one in kept) == list(range(24))
    assert list(Revisions(tmp_path).all()) == sorted(kept, key=lambda one: one.number)
    assert {one.rmse for one in Revisions(tmp_path).all()} == set(errors)
    assert len(list((tmp_path / "revisions").iterdir())) == 24


def test_without_a_folder_they_are_kept_in_memory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kept = Revisions(None)
    assert [kept.keep(revision).number for _ in range(2)] == [0, 1]
    assert kept.get(1) == revision(1)
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"no revision 7 in memory\. There are: 0, 1"):
        kept.get(7)


def test_only_what_is_a_revision_by_its_name_is_read(tmp_path):
    kept = Revisions(tmp_path).keep(revision)
    for name in ("1.json", "00001.json", "²222.json", "0001.json.json"):
        (tmp_path / "revisions" / name).write_text("nonsense")
    assert Revisions(tmp_path).all() == (kept,)


def test_a_pipe_is_not_waited_for(tmp_path):
    (tmp_path / "revisions").mkdir()
    os.mkfifo(tmp_path / "revisions" / "0002.json")
    with pytest.raises(InputError, match=r"0002\.json: is damaged: it is no regular file"):
        Revisions(tmp_path).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"number": 7}, "its number is 7"),
        ({"parent": 1}, "its parent is 1"),
        ({"effects": ["bias"], "added": ""}, "its effects are bias"),
        ({"effects": ["bias"], "removed": "bias"}, "its effects are bias"),
        ({"parameters": {}}, "its parameter damping.c is missing"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_reason(changes, words, tmp_path):
    (tmp_path / "revisions").mkdir()
    (tmp_path / "revisions" / "0001.json").write_text(revision(**{"number": 1} | changes).model_dump_json())
    with pytest.raises(InputError, match=f"0001.json: is damaged: {words}"):
        Revisions(tmp_path).all()
