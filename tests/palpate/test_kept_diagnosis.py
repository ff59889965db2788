"""What `diagnose` found is what `compare`, `add` and the report go on from."""

import json
import re

import pytest

from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.study import Study
from tests.palpate.cli import assert_refused, done, run
from tests.palpate.presses import write_own_effect, write_presses

pytestmark = pytest.mark.usefixtures("few_effects", "without_figures")


def words_of(page):
    """What a page says: without markup, and without the program that draws."""
    return re.sub("<[^>]*>", "", page.read_text().partition("<main>")[2])


@pytest.mark.slow
def test_the_report_after_adding_keeps_the_verdict_and_tells_what_was_added(tmp_path):
    data, folder = write_presses(tmp_path / "hard.csv"), tmp_path / "out"
    assert run("diagnose", data, "--out", folder).exit_code == 0
    found = json.loads((folder / RESULT).read_text())["channels"][0]
    added = done("add", data, "layered_stiffness", "--out", folder, "--force", "--json")
    report = words_of(folder / "report.html")
    for words in (
        "MISSING",
        "cubic_stiffness is missing",
        "base model and one effect",
        "contact with layered_stiffness: the error in held-out runs",
        f"palpate diagnose {data} --out {folder} --channel contact",
        "layered_stiffness --fresh",
    ):
        assert words in report
    assert json.loads(added.stdout)["revisions"][0]["noise_floor"] == found["noise_floor"]


@pytest.mark.slow
def test_a_channel_with_an_effect_of_ones_own_is_not_silently_told_without_it(tmp_path):
    """It was added by a command; the report of a study that was not given its file says so."""
    data, place, folder = write_presses(tmp_path / "hard.csv"), write_own_effect(tmp_path), tmp_path / "out"
    assert run("add", data, "mine", "--effect", place, "--out", folder).exit_code == 0
    (silent,), (whole,) = (Study(data, folder=folder, effects=given).results() for given in ((), [place]))
    assert (whole.added, whole.reason, silent.added) == (["mine"], "", [])
    for words in ("contact is shown without its added effects", f"add --effect {place}"):
        assert words in silent.reason
    page = Study(data, folder=folder).report(tmp_path / "silent.html")
    assert "contact is shown without its added effects" in words_of(page)


def test_without_a_diagnosis_the_report_tells_how_the_last_stage_fits_and_a_damaged_one_is_named(tmp_path):
    data = write_presses(tmp_path / "hard.csv")
    assert run("add", data, "cubic_stiffness", "--out", tmp_path / "out").exit_code == 0
    report = words_of(tmp_path / "out" / "report.html")
    assert "kelvin_voigt + cubic_stiffness fits contact" in report
    data = write_presses(tmp_path / "hard.csv")
    (tmp_path / RESULT).write_text("{}")
    result = run("add", data, "bias", "--out", tmp_path, "--force")
    assert_refused(result, RESULT, "damaged", "palpate diagnose again")
