"""`palpate compare`: where the model fails."""

import json
import re
import shutil

import numpy as np
import pytest

from palpate.estimation.study.saved_diagnosis import with_checksum
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import NOISE_N, write_presses, write_table

pytestmark = pytest.mark.usefixtures("few_effects", "without_figures")


@pytest.fixture(scope="module")
def grown(hardening, tmp_path_factory):
    """A folder with a revision that has what is missing, and that revision."""
    folder = tmp_path_factory.mktemp("grown")
    added = run("add", hardening, "cubic_stiffness", "--out", folder, "--json")
    return folder, json.loads(added.stdout)["revisions"][-1]


def test_comparison_reports_largest_error_of_a_hardening_object_at_depth(hardening):
    (channel,) = as_json("compare", hardening)["channels"]
    assert channel["lack_of_fit"] > 5
    assert channel["noise_floor"] < 3 * NOISE_N
    assert {"direction", "speed", "depth", "run", "effort"} <= set(channel["parts"])
    depths = channel["parts"]["depth"]
    assert depths[-1]["mean"] > 0 > depths[1]["mean"]  # a straight line through a curve that bends upwards
    assert sum(part["energy"] for part in channel["parts"]["run"]) == pytest.approx(1)
    result = done("compare", hardening)
    said = " ".join(result.stdout.split())
    assert re.match(
        r"kelvin_voigt does not fit contact: [^:]*times the noise\. By \w+, the largest error is", said
    )
    assert "palpate diagnose" in result.stderr


def test_folder_gets_the_numbers_and_a_report(hardening, tmp_path):
    result = done("compare", hardening, "--out", tmp_path / "there", "--json")
    kept = json.loads((tmp_path / "there" / "comparison.json").read_text())
    assert kept == json.loads(result.stdout)
    assert (tmp_path / "there" / "report.html").stat().st_size > 1e6
    again = done("compare", hardening, "--out", tmp_path / "again")
    assert not [words for words in next_commands(again) if "--out" in words]  # it would refuse this folder


def test_single_press_is_judged_by_its_parts_and_few_samples_are_refused(tmp_path):
    press = write_presses(tmp_path / "press.csv", speeds_m_s=(0.02,), cubic=0.0)
    result = done("compare", press, "--json")
    assert "only one run was recorded, and it goes through its motion once" in " ".join(result.stderr.split())
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["rmse"] == pytest.approx(NOISE_N, rel=0.1)
    press = write_presses(tmp_path / "press.csv", speeds_m_s=(0.02,))
    press.write_text("\n".join(press.read_text().splitlines()[:51]) + "\n")
    assert_refused(run("compare", press), "only 50 samples")


def test_extended_model_is_compared_with_the_measurement(hardening, grown):
    folder, kept = grown
    (channel,) = as_json("compare", hardening, "--revision", 1, "--folder", folder)["channels"]
    assert channel["model"] == "kelvin_voigt + cubic_stiffness"
    assert channel["rmse"] == pytest.approx(kept["rmse"])
    assert channel["lack_of_fit"] < 1.1
    assert channel["parameters"]["cubic_stiffness.k3"] == pytest.approx(2e6, rel=0.05)
    shown = run("compare", hardening, "--folder", folder)
    assert "kelvin_voigt does not fit contact" in shown.stdout
    assert next_commands(shown)[0][-4:] == ["--revision", "1", "--folder", str(folder)]


def test_revision_of_other_rows_is_reported(grown, tmp_path):
    other = write_presses(tmp_path / "other.csv", seed=5)
    told = " ".join(run("compare", other, "--revision", 1, "--folder", grown[0]).stdout.split())
    assert "revision 1 was fitted to other rows or with other import options, so its errors here" in told
    assert "differ from its saved error, " in told


def test_noise_floor_does_not_depend_on_earlier_revisions(hardening, grown, tmp_path):
    folder, other = (
        shutil.copytree(grown[0], tmp_path / "kept"),
        write_presses(tmp_path / "other.csv", seed=5),
    )
    assert len(as_json("add", other, "cubic_stiffness", "--fresh", "--out", folder)["revisions"]) == 2
    kept = as_json("revisions", hardening, "--folder", folder)["revisions"]
    for other in (folder / "revisions").glob("000[23].json"):
        quiet = json.loads(other.read_text()) | {"noise_floor": 1e-6}
        del quiet["sha256"]
        other.write_text(json.dumps(with_checksum(quiet)))
    (channel,) = as_json("compare", hardening, "--folder", folder)["channels"]
    assert {channel["noise_floor"]} == {one["noise_floor"] for one in kept[:2]}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--model", "magic"), ("magic", "kelvin_voigt")),
        (("--model", "pendulum"), ("pendulum", "contact")),
        (("--channel", "joint_9"), ("joint_9", "contact")),
        (("--revision", 9), ("no revision 9", "Available: 0, 1")),
        (("--revision", 0, "--revision", 1), ("several revisions of channel 'contact'",)),
        (("--revision", 1, "--model", "hunt_crossley"), ("leave out --model",)),
    ],
)
def test_incomparable_data_are_refused(hardening, grown, options, words):
    assert_refused(run("compare", hardening, "--folder", grown[0], *options), *words)


def test_better_base_model_is_recommended(tmp_path):
    run_number, t = np.repeat(np.arange(3), 250), np.tile(np.arange(250) * 0.02, 3)
    w = 3.0 + 0.7 * run_number
    q, a = np.sin(w * t), -(w**2) * np.sin(w * t)
    torque = 0.2 * a + 2.0 * np.sin(q) + np.random.default_rng(0).normal(0, 0.01, len(t))
    data = write_table(tmp_path / "swinging.csv", time_s=t, run=run_number, position_rad=q, torque_Nm=torque)
    for command in ("compare", "diagnose"):
        told = [words for words in next_commands(run(command, data)) if words[-2:] == ["--model", "pendulum"]]
        assert [words[0] for words in told] == [command]
    plain = next_commands(run("compare", data, "--model", "pendulum"))
    assert [words[0] for words in plain] == ["diagnose", "compare"]
