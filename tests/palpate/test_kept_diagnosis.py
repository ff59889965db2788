"""What `diagnose` found is what `compare`, `add` and the report go on from."""

import json
import re

import pytest

from estimation.diagnosis import ChannelDiagnosis, Diagnosis, Verdict
from estimation.diagnosis.result import Fitted, ParameterValue
from estimation.effects import EFFECTS
from estimation.effects.bias import Bias
from estimation.effects.deadband import SWALLOWED
from estimation.model import Model
from estimation.revision import revise
from palpate.findings.effect_library import EffectLibrary, library_with
from palpate.findings.estimation_run import NO_ARM, Material
from palpate.findings.kept_diagnosis import RESULT, kept_diagnosis
from palpate.findings.retold import retold
from palpate.findings.revisions import RevisionShelf
from palpate.findings.story import Story
from palpate.findings.subject import Subject
from palpate.render.stories import story_view
from robot_io.errors import InputError
from tests.estimation.diagnosis.test_true_force import WIDTH_N, judged, pressing
from tests.palpate.cli import assert_refused, run
from tests.palpate.presses import write_presses

ARM = Model("rigid_body", (EFFECTS["rigid_body"](),))
LIBRARY = library_with(None).effects


@pytest.fixture(scope="module")
def pressed():
    """A contact whose sensor has a dead band, as it was judged, and a joint; the true force."""
    contact, joint, true_n = pressing(noise_n=0.02, noise_nm=0.02)
    seen = judged(contact, deadband={"width": WIDTH_N})
    base = revise(contact, seen.model, ())[0].rmse
    return (
        seen.found.model_copy(update={"baseline": Fitted(rmse=base, parameters={})}),
        contact,
        joint,
        true_n,
    )


def known(folder, entries, channels):
    diagnosis = Diagnosis(file="f", model="kelvin_voigt+rigid_body", channels=entries)
    (folder / RESULT).write_text(diagnosis.model_dump_json())
    return kept_diagnosis(folder, Material(folder / "f", None, channels, {}, NO_ARM), NO_ARM, LIBRARY)


def test_a_joint_is_seen_with_the_force_by_which_it_was_judged(pressed, tmp_path):
    found, contact, joint, true_n = pressed
    subject = known(tmp_path, [found], (contact, joint)).as_judged(Subject(joint, ARM))
    assert subject.force_ahead_of == ("deadband",)
    assert subject.channel.context["contact_force"] == pytest.approx(true_n, abs=1e-9)


@pytest.mark.parametrize("why", ["other data", "judged alone", "sure of nothing"])
def test_a_force_that_nobody_corrected_is_left_as_measured(pressed, tmp_path, why):
    found, contact, joint, _ = pressed
    entries = [found]
    if why == "other data":
        entries = [found.model_copy(update={"baseline": Fitted(rmse=9.0, parameters={})})]
    if why == "sure of nothing":
        entries = [found.model_copy(update={"verdict": Verdict.UNEXPLAINED})]
    if why == "judged alone":
        told = {"verdict": Verdict.ADEQUATE, "effort_unit": "N m", "reason": ""}
        entries.append(ChannelDiagnosis(channel="joint_1", baseline=Fitted(rmse=1.0, parameters={}), **told))
    subject = Subject(joint, ARM)
    assert known(tmp_path, entries, (contact, joint)).as_judged(subject) is subject


def told_by_the_joint(found, std_err=0.01, name="width"):
    """The contact's answer, as if its joint had shown the dead band."""
    width = ParameterValue(value=WIDTH_N, std_err=std_err, unit="N")
    changed = {"told_by": ["joint_1"], "parameters": {name: width}}
    return found.model_copy(update={"accepted": [found.accepted[0].model_copy(update=changed)]})


def as_pressed(seen):
    return Subject(seen.data, seen.model)


def test_a_contact_has_the_dead_band_that_its_joints_showed(pressed, tmp_path):
    found, contact, joint, _ = pressed
    subject = as_pressed(judged(contact))
    seen = known(tmp_path, [told_by_the_joint(found)], (contact, joint)).as_judged(subject)
    assert seen.channel.context[SWALLOWED][0] == pytest.approx([WIDTH_N, 0.01])


@pytest.mark.parametrize("why", ["other data", "not determined", "one run today"])
def test_a_contact_has_no_dead_band_that_nobody_knows(pressed, tmp_path, why):
    found, contact, joint, _ = pressed
    entry = told_by_the_joint(found, std_err=None if why == "not determined" else 0.01)
    if why == "other data":
        entry = entry.model_copy(update={"baseline": Fitted(rmse=9.0, parameters={})})
    if why == "one run today":
        contact = contact.select(contact.run == 0)
    subject = as_pressed(judged(contact))
    assert known(tmp_path, [entry], (contact, joint)).as_judged(subject) is subject


def test_joints_go_on_where_the_contact_cannot_be_judged_any_more(pressed, tmp_path):
    found, contact, joint, _ = pressed
    one_run = contact.select(contact.run == 0)
    subject = Subject(joint, ARM)
    assert known(tmp_path, [found], (one_run, joint)).as_judged(subject) is subject


def test_a_dead_band_without_its_width_is_damage(pressed, tmp_path):
    found, contact, joint, _ = pressed
    with pytest.raises(InputError, match=r"damaged.*'contact'.*width"):
        known(tmp_path, [told_by_the_joint(found, name="wide")], (contact, joint))


def test_the_report_after_adding_keeps_the_verdict_and_tells_what_was_added(tmp_path):
    data, folder = write_presses(tmp_path / "hard.csv"), tmp_path / "out"
    assert run("diagnose", data, "--out", folder).exit_code == 0
    found = json.loads((folder / RESULT).read_text())["channels"][0]
    added = run("add", data, "layered_stiffness", "--out", folder, "--force", "--json")
    assert added.exit_code == 0, added.stderr
    report = re.sub("</?b>", "", (folder / "report.html").read_text().rpartition("</head>")[2])
    for words in (
        "MISSING",
        "cubic_stiffness is missing",
        "alone beside the base model",
        "Added since: contact with layered_stiffness",
        f"palpate diagnose {data} --out {folder} --channel contact",
        "layered_stiffness --fresh",
    ):
        assert words in report
    assert json.loads(added.stdout)["revisions"][0]["noise_floor"] <= found["noise_floor"]


class Mine(Bias):
    """An effect of the user's own."""

    name = "mine"


def test_a_channel_with_an_effect_of_ones_own_is_not_silently_told_without_it(pressed, tmp_path):
    found, contact, joint, _ = pressed
    kept, shelf = known(tmp_path, [found], (contact, joint)), RevisionShelf(tmp_path)
    own, library = {"mine": "mine.py:Mine"}, (*LIBRARY, Mine())
    stages = revise(contact, judged(contact).model, ["mine"], library)
    shelf.keep("contact", "N", stages, parent=None, user_effects=own)
    grown = Story(Subject(joint, ARM), None, None, ())
    material = Material(tmp_path / "f", None, (contact, joint), {}, NO_ARM)

    def told(given):
        return retold(grown, material, NO_ARM, shelf, given, kept)[1]

    silent, whole = told(EffectLibrary(LIBRARY, {})), told(EffectLibrary(library, own))
    assert (whole.added, whole.left_out, silent.added) == (["mine"], "", [])
    for words in ("contact is told without what was added", "add --effect mine.py:Mine"):
        assert words in silent.left_out
    assert silent.left_out in story_view(silent).verdict.remarks


def test_without_a_diagnosis_the_report_tells_how_the_last_stage_fits(tmp_path):
    data = write_presses(tmp_path / "hard.csv")
    assert run("add", data, "cubic_stiffness", "--out", tmp_path / "out").exit_code == 0
    report = re.sub("</?b>", "", (tmp_path / "out" / "report.html").read_text())
    assert "kelvin_voigt + cubic_stiffness fits contact" in report


def test_a_damaged_diagnosis_is_named(tmp_path):
    data = write_presses(tmp_path / "hard.csv")
    (tmp_path / RESULT).write_text("{}")
    assert_refused(run("compare", data, "--folder", tmp_path), RESULT, "damaged", "palpate diagnose again")
