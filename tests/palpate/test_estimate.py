"""`palpate estimate` on sessions and data files."""

import json
import re

import numpy as np
import pytest

from palpate.common.console import significant
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.study.estimates import choose_estimators
from palpate.estimation.study.source import open_source
from palpate.render.estimates import _value_text
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.scenario import load_scenario
from tests.log_in_process import LogInProcess
from tests.palpate.cli import as_json, assert_refused, done, run
from tests.palpate.presses import press_columns, write_presses, write_table


def estimate_json(*arguments):
    return as_json("estimate", *arguments)


def lsq_parameters(*arguments):
    """Parameters of the only channel by least squares."""
    (channel,) = estimate_json(*arguments, "--estimator", "lsq")["channels"]
    return channel["estimates"][0]["parameters"]


def spoil(path, column, change):
    """Presses on a spring beside a damper, with one column changed."""
    columns = press_columns(write_presses(path, cubic=0.0))
    return write_table(path, **columns | {column: change(columns[column])})


def test_every_estimator_finds_the_simulated_object(probed):
    data = estimate_json(probed[0], "--all")
    (channel,) = data["channels"]
    assert (data["model"], channel["channel"], channel["runs"]) == ("kelvin_voigt", "contact", 3)
    assert {estimate["estimator"] for estimate in channel["estimates"]} == set(ESTIMATORS)
    for estimate in channel["estimates"]:
        stiffness, damping = (estimate["parameters"][name] for name in ("stiffness.k", "damping.c"))
        assert stiffness["truth"] == 500.0
        assert abs(stiffness["error_percent"]) < 1.0
        assert abs(damping["error_percent"]) < 5.0
        assert stiffness["interval"][0] < stiffness["value"] < stiffness["interval"][1]
        assert estimate["surface"]["position_m"] == pytest.approx(-0.05, abs=1e-4)


def test_table_shows_truth_error_and_interval_of_chosen_estimators(probed):
    shown = run("estimate", probed[0]).stdout
    for words in (
        *("k", "[N/m]", "[N s/m]", "±", "error", "truth", "500"),
        *("robust", "surface at -", "(truth -50.00"),
    ):
        assert words in shown
    assert "does not describe" not in shown
    (channel,) = estimate_json(probed[0])["channels"]
    assert [estimate["estimator"] for estimate in channel["estimates"]] == ["lsq", "robust", "ransac"]
    data = estimate_json(probed[0], "--where", "run=1", "--estimator", "lsq,robust")
    (channel,) = data["channels"]
    assert channel["runs"] == 1
    assert [estimate["estimator"] for estimate in channel["estimates"]] == ["lsq", "robust"]


def test_data_file_is_estimated_and_only_a_poor_fit_is_reported(tmp_path):
    data = estimate_json(write_presses(tmp_path / "mine.csv", cubic=0.0), "--estimator", "lsq")
    assert data["channels"][0]["misfit"]["times"] < 1.5
    parameters = data["channels"][0]["estimates"][0]["parameters"]
    assert parameters["stiffness.k"]["value"] == pytest.approx(400, rel=0.01)
    assert parameters["damping.c"]["value"] == pytest.approx(6, rel=0.05)
    assert "truth" not in parameters["stiffness.k"]
    assert (data["channels"][0]["truth"], data["channels"][0]["spoilt"]) == ({}, None)
    t = np.arange(0, 2, 0.002)
    depth = 0.006 - 0.005 * np.cos(6 * t)
    force = 2e6 * depth**2 + np.random.default_rng(0).normal(0, 0.02, len(t))
    file = write_table(tmp_path / "stiffening.csv", time_s=t, displacement_m=depth, force_N=force)
    shown = " ".join(run("estimate", file).stdout.split())
    assert "kelvin_voigt does not describe these data" in shown
    assert estimate_json(file)["channels"][0]["misfit"]["times"] > 30


@pytest.mark.parametrize(
    ("bend", "words"),
    [
        (lambda force: np.full(len(force), 3.0), "the effort never changes"),
        (lambda force: np.minimum(force, 0.5 * force.max()), "the sensor is saturated"),
    ],
)
def test_insufficient_data_are_reported_like_in_the_diagnosis(tmp_path, bend, words):
    file = spoil(tmp_path / "presses.csv", "force_N", bend)
    shown = " ".join(run("estimate", file, "--estimator", "lsq").stdout.split())
    assert words in shown.partition("do not rely on these estimates: ")[2]
    assert words in estimate_json(file, "--estimator", "lsq")["channels"][0]["spoilt"]


def test_implausible_data_are_reported_and_estimated(tmp_path):
    file = spoil(tmp_path / "presses.csv", "displacement_m", lambda depth: 100.0 * depth)
    result = done("estimate", file, "--estimator", "lsq", "--json")
    words = "contact: the deepest indentation is 1 m, more than 0.2 m; if the displacement is in millimeters"
    assert words in " ".join(result.stderr.split())
    estimate = json.loads(result.stdout)["channels"][0]["estimates"][0]
    assert estimate["parameters"]["stiffness.k"]["value"] == pytest.approx(4.0, rel=0.02)


def test_columns_and_units_are_given_as_options(tmp_path):
    t, depth, force, number = press_columns(write_presses(tmp_path / "mine.csv", cubic=0.0)).values()
    file = write_table(tmp_path / "mine.csv", clock=t, depth=depth, load=1000.0 * force, run=number)
    options = []
    for pair in ("time_s=clock", "displacement_m=depth", "force_mN=load"):
        options += ["--column", pair]
    assert lsq_parameters(file, *options)["stiffness.k"]["value"] == pytest.approx(400, rel=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--estimator", "magic"), ("magic", "robust")),
        (("--estimator", ""), ("estimator",)),
        (("--model", "magic"), ("magic", "kelvin_voigt")),
        (("--where", "run=9"), ("--where run=9", "0, 1, 2")),
        (("--column", "force_N=load"), ("--column", "data files")),  # a session has its columns
        (("--fresh-runs",), ("--fresh-runs", "data files")),
        (("--all", "--estimator", "lsq"), ("--all", "--estimator lsq")),
    ],
)
def test_bad_options_are_refused(probed, options, words):
    assert_refused(run("estimate", probed[0], *options), *words)


@pytest.fixture
def joint(tmp_path):
    """A joint that swings 0.2 kg m2 against 0.5 N m s/rad, with a little noise."""
    rng = np.random.default_rng(2)
    t = np.arange(0, 6, 0.005)
    position = 0.8 * np.sin(3 * t) + 0.2 * np.sin(11 * t)
    velocity = 2.4 * np.cos(3 * t) + 2.2 * np.cos(11 * t)
    acceleration = -7.2 * np.sin(3 * t) - 24.2 * np.sin(11 * t)
    torque = 0.2 * acceleration + 0.5 * velocity + rng.normal(0, 0.01, len(t))
    return write_table(tmp_path / "joint.csv", time_s=t, position_rad=position, torque_Nm=torque)


def test_joint_is_estimated_with_a_joint_model(joint):
    (channel,) = estimate_json(joint, "--model", "inertia", "--estimator", "lsq")["channels"]
    values = [parameter["value"] for parameter in channel["estimates"][0]["parameters"].values()]
    assert values == pytest.approx([0.2, 0.5], rel=0.01)
    assert estimate_json(joint, "--estimator", "lsq")["channels"] == [channel]  # the model that suits it


def test_error_of_inliers_is_stated_beside_that_of_all_samples(tmp_path):
    t = np.arange(400) * 0.01
    q, spiked = 0.5 * np.sin(3.0 * t), np.arange(400) % 40 == 20
    noise = np.random.default_rng(1).normal(0.0, 1e-3, 400)
    torque = 2.0 * q + 0.3 * np.gradient(q, t) + noise + 5.0 * spiked
    path = write_table(tmp_path / "joint.csv", time_s=t, position_rad=q, torque_Nm=torque)
    said = estimate_json(path, "--model", "spring_mass_damper", "--estimator", "lsq,robust")
    least, robust = said["channels"][0]["estimates"]
    assert least["rmse"] == least["rmse_inliers"]
    assert robust["rmse"] == pytest.approx(5.0 * np.mean(spiked) ** 0.5, rel=0.02)
    assert robust["rmse_inliers"] < 2e-3
    assert {p["at_bound"] for p in robust["parameters"].values()} == {False}


def test_unphysical_parameter_is_reported_once_as_undetermined(tmp_path):
    """A joint that swings so slowly that its inertia does nothing; the dry friction that it has does."""
    t = np.arange(0, 6, 0.005)
    velocity = 0.1 * np.cos(0.2 * t)
    torque = 0.5 * velocity + 0.1 * np.sign(velocity) + np.random.default_rng(2).normal(0, 0.01, len(t))
    swing = {"time_s": t, "position_rad": 0.5 * np.sin(0.2 * t), "torque_Nm": torque}
    file = write_table(tmp_path / "slow.csv", **swing)
    shown = run("estimate", file, "--all").stdout
    assert shown.count("m impossible") == len(ESTIMATORS)
    assert "yes" not in shown.split()
    assert shown.count("outside the physical bounds") <= 2  # one estimator may say more
    (channel,) = estimate_json(file)["channels"]
    for estimate in channel["estimates"]:
        inertia = estimate["parameters"]["inertia.m"]
        assert (inertia["unit"], estimate["unphysical"]) == ("kg m^2", ["inertia.m"])
        assert inertia["value"] < 0.0


@pytest.mark.parametrize(("damping", "state"), [(6.0, "yes"), (0.0, "no")])
def test_parameter_with_zero_in_its_interval_is_not_determined(tmp_path, damping, state):
    file = write_presses(tmp_path / "mine.csv", force_of=lambda x, v: 400 * x + damping * v)
    parameters = lsq_parameters(file)
    low, high = parameters["damping.c"]["interval"]
    assert (low < 0.0 < high) == (state == "no")
    assert (parameters["stiffness.k"]["determined"], parameters["damping.c"]["determined"]) == ("yes", state)
    said = run("estimate", file, "--estimator", "lsq").stdout.split()
    assert ("yes" in said, "not" in said) == (state == "yes", state == "no")


@pytest.mark.parametrize(
    ("model", "width"), [("kelvin_voigt", 60), ("hunt_crossley", 120), ("spring_mass_damper", 60)]
)
def test_values_are_aligned_with_their_headings(hardening, monkeypatch, model, width):
    monkeypatch.setenv("COLUMNS", str(width))
    lines = run("estimate", hardening, "--model", model).stdout.splitlines()
    rule = next(number for number, line in enumerate(lines) if set(line) == {"─", " "})
    end = next(number for number in range(rule, len(lines)) if not lines[number].strip())
    heading, rows = lines[rule - 1], [line for line in lines[rule + 1 : end] if "±" in line]
    assert len(rows) >= 3
    assert max(map(len, lines)) <= width
    for title in re.finditer(r"\[[^]]+\]|95 %", heading):
        for row in rows:
            assert row[title.end() - 1] != " "
            assert row[title.end() : title.end() + 2].strip() == ""


def test_model_without_its_inputs_is_refused(joint, probed, tmp_path):
    assert_refused(run("estimate", joint, "--model", "rigid_body_fitted"), "--urdf")
    assert_refused(
        run("estimate", joint, "--model", "rigid_body_fitted", "--urdf", tmp_path / "x"), "no such file"
    )
    assert_refused(run("estimate", probed[0], "--model", "rigid_body"), "no free parameter")


def test_model_with_many_parameters_gets_a_row_for_each(probed):
    chosen = ("--model", "rigid_body_fitted", "--estimator", "lsq", "--where", "run=0")
    result = done("estimate", probed[0], *chosen)
    assert len([line for line in result.stdout.splitlines() if "kg m" in line]) > 6


def test_failing_estimator_does_not_end_the_others(tmp_path):
    """Four samples are too few for a subset of RANSAC."""
    depth, t = np.array([-0.001, 0.001, 0.005, 0.012, 0.02]), np.arange(5) / 100
    force = 500 * depth.clip(0) + np.array([0.0, 0.1, -0.1, 0.1, -0.1])
    file = write_table(tmp_path / "rough.csv", time_s=t, displacement_m=depth, force_N=force)
    (channel,) = estimate_json(file, "--estimator", "ransac,lsq")["channels"]
    assert [estimate["estimator"] for estimate in channel["estimates"]] == ["lsq"]
    assert "subsets of 5 samples" in channel["failures"]["ransac"]
    assert_refused(run("estimate", file, "--estimator", "ransac"), "ransac")


def test_estimator_names_are_parsed():
    assert choose_estimators("all") == list(ESTIMATORS)
    assert choose_estimators(" lsq , robust") == ["lsq", "robust"]


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (500.0236, 0.123, "500.02"),
        (59938329.0, 205928.0, "59940000"),
        (0.00123456, 0.0000042, "0.0012346"),
        (1234.5678, None, "1234.6"),
        (1234.5678, float("nan"), "1.2e+03"),
        (-0.0004, 0.12, "0.00"),
        (-0.0, None, "0"),
        (2.3e29, 4.5e29, "2.3e+29"),
        (-5e9, 9.8e10, "-5e+09"),
        (59938329000.0, 205928000.0, "59940000000"),
    ],
)
def test_value_has_as_many_digits_as_its_uncertainty_allows(value, uncertainty, text):
    assert significant(value, uncertainty) == text


def test_unknown_interval_is_shown_as_unknown():
    unknown = ParameterEstimate("k", "N/m", 5.0, float("nan"), (float("nan"), float("nan")))
    assert _value_text(unknown) == "5 (not determined)"


def test_truth_of_the_object_is_not_compared_with_a_joint(probed):
    chosen = ("--model", "spring_mass_damper", "--estimator", "lsq", "--where", "run=0")
    data = estimate_json(probed[0], *chosen)
    joints = [channel for channel in data["channels"] if channel["channel"] != "contact"]
    assert joints
    for channel in joints:
        assert channel["truth"] == {}
        assert "truth" not in channel["estimates"][0]["parameters"]["stiffness.k"]


def test_truncated_session_is_reported(probed, tmp_path):
    whole, part = probed[0].read_bytes(), tmp_path / "part.mcap"
    part.write_bytes(whole[: len(whole) * 2 // 3])
    for file, cut_off in ((part, True), (probed[0], False)):
        estimated = done("estimate", "--estimator", "lsq", file, "--json")
        assert json.loads(estimated.stdout)["cut_off"] is cut_off
        for result in (estimated, run("compare", "--channel", "contact", file)):
            assert ("the session file is cut off" in result.stderr) is cut_off


def test_invalid_session_file_is_no_data_file(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"nonsense")
    for command in ("estimate", "info"):
        assert_refused(run(command, tmp_path / "x.mcap"), "not a palpate session")


def test_model_for_another_channel_is_refused_in_words(probed, tmp_path):
    refused = run("estimate", write_presses(tmp_path / "mine.csv", cubic=0.0), "--model", "inertia")
    words = ("describes a prismatic joint or revolute joint", "contact (contact)", "--model: hunt_crossley")
    assert_refused(refused, *words)


BIAS_N = 0.5


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("tare") / "a.mcap"
    hidden = [IMPERFECTIONS["bias"](channel="contact", bias=BIAS_N)]
    plan = ProbingPlan(speeds_m_s=(0.15, 0.06), hold_s=0.2)
    scenario = load_scenario("default").with_hidden(hidden)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.runs.session.SessionWriter", LogInProcess)
        run_probing(ProbingJob(find_robot("follower"), path, plan, scenario=scenario, seed=3, online=None))
    return path


def test_zero_is_subtracted_except_in_a_diagnosis_of_bias(session):
    result = run("estimate", session, "--estimator", "lsq", "--json")
    (channel,) = json.loads(result.stdout)["channels"]
    assert [tare["effort"] for tare in channel["tare"]] == pytest.approx([BIAS_N, BIAS_N], abs=0.01)
    (estimate,) = channel["estimates"]
    surface, stiffness = estimate["surface"], estimate["parameters"]["stiffness.k"]
    assert abs(surface["position_m"] + 0.05) < 4 * surface["std_err_m"] < 1e-4
    assert abs(stiffness["value"] - stiffness["truth"]) < 4 * stiffness["std_err"]
    shown = " ".join(run("estimate", session, "--estimator", "lsq").stdout.split())
    assert re.search(r"the force in free air, 0\.(50|49)\d+ N, was subtracted", shown)
    channel = open_source(session).channels[0]
    assert channel.tare is None
    assert np.mean(channel.effort[:100]) == pytest.approx(BIAS_N, abs=0.01)
