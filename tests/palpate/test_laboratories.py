"""Files of many laboratories, read without an option: imported, diagnosed, and their truth found."""

import json

import pytest

from tests.estimation.laboratories import LABORATORIES
from tests.palpate.cli import run

IDS = [one.__name__ for one in LABORATORIES]


@pytest.mark.parametrize(("write", "verdict", "truth"), [(w, *t) for w, t in LABORATORIES.items()], ids=IDS)
def test_a_file_is_diagnosed_as_it_is(tmp_path, monkeypatch, write, verdict, truth):
    monkeypatch.chdir(tmp_path)
    result = run("diagnose", write(tmp_path), "--json")
    assert result.exit_code == 0, result.stderr
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["verdict"] == verdict, channel["reason"]
    found = channel["final"]["parameters"]
    for name, (value, off) in truth.items():
        assert found[name]["value"] == pytest.approx(value, rel=off), name


@pytest.mark.parametrize("write", LABORATORIES, ids=IDS)
def test_what_was_taken_for_what_is_said(tmp_path, write):
    path = write(tmp_path)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    result = run("import", *files, "-o", tmp_path / "session.mcap", "--json")
    assert result.exit_code == 0, result.stderr
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["runs"] == (1 if channel["kind"] == "revolute" else 4)
    assert "read: " in result.stderr
    assert "time '" in result.stderr
