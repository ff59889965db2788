"""Revisions in their folder: several programs may write there, and anybody may put things there."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from estimation.effects import EFFECTS
from estimation.model import Model
from estimation.revision import Revision
from palpate import files
from palpate.findings.revisions import RevisionShelf
from robot_io.errors import InputError

NOTHING = np.zeros(0)
SPRING = Model("spring", (EFFECTS["stiffness"](),))


def stages(rmse):
    told = (SPRING, {}, NOTHING, NOTHING, rmse, rmse / 2, 0.0)
    return Revision(0, "", *told), Revision(1, "bias", *told)


def keep(folder, rmse):
    return RevisionShelf(folder).keep("contact", "N", stages(rmse), parent=None, user_effects={})


@pytest.fixture
def unchecked(monkeypatch):
    """Revisions of a model that nobody has."""
    monkeypatch.setattr("palpate.findings.revisions.flaw", lambda revision, number: None)


@pytest.mark.parametrize("links", [True, False])
def test_what_two_write_at_once_is_all_kept(links, unchecked, tmp_path, monkeypatch):
    """Both have read that there is nothing yet."""
    if not links:
        monkeypatch.setattr(
            files.os, "link", lambda *_: (_ for _ in ()).throw(PermissionError(1, "no links"))
        )
    read = RevisionShelf.all
    with monkeypatch.context() as blind:
        blind.setattr(RevisionShelf, "all", lambda shelf: [])
        first, second = keep(tmp_path, 1.0), keep(tmp_path, 2.0)
    assert [(one.number, one.parent) for one in (*first, *second)] == [(0, None), (1, 0), (2, None), (3, 2)]
    assert read(RevisionShelf(tmp_path)) == [*first, *second]
    assert not [file for file in (tmp_path / "revisions").iterdir() if file.name.startswith(".")]


def test_of_many_writers_of_one_name_one_alone_wrote_it(tmp_path, monkeypatch):
    names = iter(range(100))
    monkeypatch.setattr(files, "_unfinished", lambda path: path.with_name(f".{next(names)}"))
    with ThreadPoolExecutor(8) as pool:
        wrote = list(pool.map(lambda n: files.write_new_text(tmp_path / "a", str(n)), range(40)))
    assert (tmp_path / "a").read_text() == str(wrote.index(True))
    assert sum(wrote) == 1


def test_only_what_is_a_revision_by_its_name_is_read(unchecked, tmp_path):
    kept = keep(tmp_path, 1.0)
    for name in ("1.json", "00001.json", "²222.json", "0001.json.json"):
        (tmp_path / "revisions" / name).write_text("nonsense")
    assert RevisionShelf(tmp_path).all() == kept


def test_a_pipe_is_not_waited_for(tmp_path):
    (tmp_path / "revisions").mkdir()
    os.mkfifo(tmp_path / "revisions" / "0002.json")
    with pytest.raises(InputError, match=r"0002\.json: is damaged: it is no regular file"):
        RevisionShelf(tmp_path).all()
