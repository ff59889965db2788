"""Implausible recordings are diagnosed, and their result carries the warnings."""

import json

import numpy as np
import pytest

from tests.palpate.cli import done
from tests.palpate.presses import write_presses, write_table

pytestmark = pytest.mark.usefixtures("few_effects", "without_figures")


def test_warnings_reach_the_diagnosis_in_its_file_and_on_the_screen(tmp_path):
    file = write_presses(tmp_path / "presses.csv", cubic=0.0)
    time_s, x, force, run = np.loadtxt(file, delimiter=",", skiprows=1).T
    write_table(file, time_s=time_s, displacement_m=50.0 * x, force_N=force, run=run)
    result = done("diagnose", file, "--json", "--out", tmp_path / "out")
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["verdict"] == "adequate"
    words = "the deepest indentation is 0.5 m, more than 0.2 m"
    assert words in channel["warnings"][0]
    assert words in " ".join(result.stderr.split())
    kept = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert kept["channels"][0]["warnings"] == channel["warnings"]
    assert words in (tmp_path / "out" / "report.html").read_text()


def test_notes_of_two_files_that_are_alike_are_said_once(tmp_path):
    for seed, name in enumerate(("a.csv", "b.csv")):
        file = write_presses(tmp_path / name, seed=seed)
        text = file.read_text().replace("displacement_m,force_N", "Way [m],Load [N]", 1)
        file.write_text(text)
    result = done("compare", tmp_path / "a.csv", tmp_path / "b.csv")
    assert result.stderr.count("read: ") == 1
