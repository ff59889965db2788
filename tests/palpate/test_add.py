"""`palpate add` and `palpate revisions`: saved, continued and reverted stages."""

import numpy as np
import pytest

from palpate.study import Study
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import write_own_effect, write_table

pytestmark = pytest.mark.usefixtures("without_figures")


def add(data, folder, *arguments):
    return as_json("add", data, *arguments, "--out", folder)["revisions"]


def test_stages_are_saved_continued_and_reverted(hardening, tmp_path):
    first = add(hardening, tmp_path, "bias")
    page = (tmp_path / "report.html").read_text()
    assert [(r["number"], r["parent"]) for r in first] == [(0, None), (1, 0)]
    (second,) = add(hardening, tmp_path, "quadratic_damping")
    assert (second["parent"], second["effects"]) == (1, ["bias", "quadratic_damping"])
    (third,) = add(hardening, tmp_path, "cubic_stiffness", "--from", 0)
    assert (third["number"], third["parent"], third["effects"]) == (3, 0, ["cubic_stiffness"])
    assert third["rmse"] < first[1]["rmse"] < first[0]["rmse"]
    assert (tmp_path / "report.html").read_text() != page
    listed = as_json("revisions", hardening, "--folder", tmp_path)["revisions"]
    assert listed == [*first, second, third]
    shown = run("revisions", hardening, "--folder", tmp_path).stdout
    assert "kelvin_voigt + cubic_stiffness" in shown


def test_report_follows_the_removal_of_an_effect(hardening, tmp_path):
    add(hardening, tmp_path, "bias", "cubic_stiffness")
    assert "bias cubic_stiffness --fresh" in (tmp_path / "report.html").read_text()
    removed = done("remove", hardening, "bias", "--folder", tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "cubic_stiffness --fresh" in page
    assert "bias cubic_stiffness" not in page
    assert "report.html" in removed.stdout.replace("\n", "")


def test_revisions_of_other_data_are_pointed_out(hardening, tmp_path):
    add(hardening, tmp_path, "bias")
    assert "data differ" not in run("revisions", hardening, "--folder", tmp_path).stderr
    shorter = tmp_path / "shorter.csv"
    shorter.write_text(hardening.read_text().rstrip().rpartition("\n")[0] + "\n")
    add(shorter, tmp_path, "bias")
    warned = " ".join(run("revisions", shorter, "--folder", tmp_path).stderr.split())
    assert "revision 0, 1: the data differ" in warned


def test_model_of_the_newest_revision_is_the_default(tmp_path):
    t = np.arange(300) * 0.02
    torque = 0.2 * -9 * np.sin(3 * t) + 0.5 * 3 * np.cos(3 * t) + 2 * np.sin(np.sin(3 * t))
    torque += np.random.default_rng(0).normal(0, 0.01, len(t))
    joint = write_table(tmp_path / "joint.csv", time_s=t, position_rad=np.sin(3 * t), torque_Nm=torque)
    add(joint, tmp_path, "quadratic_friction")
    first = add(joint, tmp_path, "bias", "--model", "pendulum")
    (second,) = add(joint, tmp_path, "coulomb_friction")
    assert (second["model"], second["parent"]) == ("pendulum", first[-1]["number"])
    again = run("add", joint, "bias", "--out", tmp_path)
    assert_refused(again, f"revision {second['number']} already contains bias", "--from", "--fresh")
    assert add(joint, tmp_path, "bias", "--fresh")[-1]["model"] == "inertia"


def test_a_comparison_is_advised_only_while_the_model_fails(hardening, tmp_path):
    for effect, is_advised in (("bias", True), ("cubic_stiffness", False)):
        advised = next_commands(done("add", hardening, effect, "--fresh", "--out", tmp_path))
        assert ("compare" in [words[0] for words in advised]) == is_advised
    assert (tmp_path / "revisions.rrd").is_file()


def test_invalid_addition_is_refused_without_a_fit(hardening, tmp_path, monkeypatch):
    folder = tmp_path / "none"
    assert_refused(run("add", hardening, "cubic_stifness", "--out", folder), "cubic_stiffness")
    assert not folder.exists()
    monkeypatch.setattr("palpate.study.Study.add", lambda *_, **__: pytest.fail("fitted"))
    refused = run("add", hardening, "bias", "--out", "/proc/palpate")
    assert_refused(refused, "/proc/palpate", "cannot be written")


def test_saved_user_effect_runs_only_on_request(hardening, tmp_path):
    place = write_own_effect(tmp_path)
    assert add(hardening, tmp_path, "mine", "--effect", place)[1]["user_effects"] == [place]
    assert_refused(run("add", hardening, "bias", "--out", tmp_path), "--effect", "Mine")
    (after,) = add(hardening, tmp_path, "bias", "--effect", place)
    assert after["effects"] == ["mine", "bias"]
    assert "cannot check whether the model fits" in run("export", hardening, "--folder", tmp_path).stderr
    for command in ("export", "revisions", "compare"):
        said = next_commands(run(command, hardening, "--folder", tmp_path))
        (again,) = [words for words in said if words[0] == "compare" and "--revision" in words]
        assert again[again.index("--effect") + 1] == place
    steps = next_commands(run("revisions", hardening, "--folder", tmp_path))
    assert [words[words.index("--effect") + 1] for words in steps] == [place] * 3


def test_missing_revisions_give_a_hint_and_a_damaged_one_is_named(hardening, tmp_path):
    result = done("revisions", hardening, "--folder", tmp_path)
    assert "no revisions yet" in result.stdout
    assert "--apply" in result.stderr
    (tmp_path / "revisions").mkdir()
    (tmp_path / "revisions" / "0000.json").write_text('{"number": 0}')
    for command in ("revisions", "export"):
        assert_refused(run(command, hardening, "--folder", tmp_path), "0000.json", "is damaged: ")


def test_runs_are_held_out_by_an_option(hardening, tmp_path):
    base, added = add(hardening, tmp_path, "cubic_stiffness", "--held-out", "1")
    other = Study(hardening, held_out=[1], keep=False).fit("contact", ["cubic_stiffness"])
    assert added["rmse"] == other.rmse < base["rmse"]
    result = run("compare", hardening, "--held-out", "1", "--folder", tmp_path)
    assert any("--held-out 1" in " ".join(words) for words in next_commands(result))
    assert (
        "--held-out 1: this command leaves these runs out"
        in run("estimate", hardening, "--held-out", "1").stderr
    )
    assert_refused(run("add", hardening, "bias", "--held-out", "one"), "--held-out one")
    assert_refused(run("add", hardening, "bias", "--held-out", "9"), "no run 9")
