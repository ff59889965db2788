"""`palpate probe --hidden` and `palpate reveal`: hidden effects act, are sealed, and are revealed."""

import json
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.source import open_source
from palpate.robot_io.calibration.applied import Calibrations
from palpate.robot_io.errors import SessionError
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import SEAL, command_line, hide
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from palpate.runs.session import ArmJob, arm_session
from palpate.sim_backend.hidden import SealedAnswer, draw_hidden, noise_scale, seal, sealed_path, unseal
from palpate.sim_backend.imperfection import IMPERFECTIONS, parse_imperfection
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.study import Study
from tests.few_effects import try_few_effects
from tests.mock_robot import write_mock_files
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.sessions import QUICK, QUICK_RUN

pytestmark = pytest.mark.usefixtures("log_in_process", "without_figures")
BIAS = [{"effect": "bias", "channel": "contact", "bias": 0.5}]
SHORT = ("--experiment", QUICK, "--online", "none")


@pytest.fixture(scope="module")
def mystery(tmp_path_factory):
    """A session with an effect drawn by seed 8."""
    path = tmp_path_factory.mktemp("mystery") / "mystery.mcap"
    result = done("probe", "--hidden", "random", "--seed", 8, "-o", path, "--json", *SHORT)
    assert json.loads(result.stdout)["sealed"] == str(sealed_path(path))
    return path


def test_drawn_hidden_effect_is_revealed_on_request(mystery):
    revealed = as_json("reveal", mystery)
    (drawn,) = draw_hidden(8)
    (entry,) = revealed["hidden"]
    assert revealed["seed"] == 8
    assert (entry["effect"], entry["channels"]) == (drawn.name, list(drawn.channels))
    values = {name: about["value"] for name, about in entry["parameters"].items()}
    assert values.items() <= drawn.describe().items()
    assert all(about["unit"] for about in entry["parameters"].values())
    told = run("reveal", mystery)
    assert drawn.name in told.stdout
    assert drawn.channels[0] in told.stdout
    assert next_commands(told)[-1] == ["diagnose", str(mystery)]


def test_only_the_sealed_file_contains_the_hidden_effect(mystery):
    metadata = Session.open(mystery).metadata
    texts = [metadata.scenario, metadata.robot_file, metadata.command_line, *metadata.extra.values()]
    said = run("info", mystery).stdout + sealed_path(mystery).read_text() + "".join(texts)
    assert draw_hidden(8)[0].name not in said
    assert "hidden" not in metadata.scenario


def test_unit_of_a_sensor_effect_is_that_of_its_signal():
    units = {
        channel: IMPERFECTIONS["drift"](channel=channel, rate_1_s=1.0).values()["rate_1_s"][1]
        for channel in ("contact", "joint_1", "encoder_1")
    }
    assert units == {"contact": "N/s", "joint_1": "N m/s", "encoder_1": "rad/s"}


@pytest.mark.parametrize(("second", "shown"), [(0.0, 2), (100.0, 4)])
def test_second_branch_is_revealed_only_if_present(second, shown):
    entry = {"effect": "stress_relaxation", "stiffness_n_m": 250.0, "time_s": 0.1}
    assert len(parse_imperfection(entry | {"second_stiffness_n_m": second}).values()) == shown


def test_effects_of_a_file_act_and_are_not_named_in_the_session(tmp_path, monkeypatch):
    entry = {"effect": "cubic_stiffness", "cubic_n_m3": 2e6}
    (tmp_path / "cubic.yaml").write_text(f"hidden: [{json.dumps(entry)}]\n")
    path = tmp_path / "a.mcap"
    arguments = ["probe", "--hidden", tmp_path / "cubic.yaml", "-o", path, "--seed", 2, *SHORT]
    monkeypatch.setattr("sys.argv", ["palpate", *map(str, arguments)])
    assert "a.mcap.sealed" in done(*arguments).stdout
    line = Session.open(path).metadata.command_line
    assert shlex.split(line)[:6] == ["palpate", "probe", "--hidden", "(sealed)", "-o", str(path)]
    assert command_line(["probe", "--hidden=bias"], "bias").endswith(" probe '--hidden=(sealed)'")
    answer = unseal(sealed_path(path))
    assert [found.describe() for found in answer.hidden] == [entry]
    assert answer.seed is None
    ticks = Session.open(path).samples("tick")
    depth = 0.05 - ticks["tip_position_world_m"][:, 2]
    held = (ticks["force_n"] > 9) & (np.abs(ticks["tip_velocity_world_m_s"][:, 2]) < 1e-3)
    expected = 500 * depth[held] + 2e6 * depth[held] ** 3
    assert ticks["force_n"][held] == pytest.approx(expected, abs=0.2)
    assert depth[held].mean() < 0.018


def test_scenario_with_hidden_effects_is_sealed_and_not_stored(tmp_path):
    (tmp_path / "own.yaml").write_text("seed: 4\nhidden: [{effect: bias, channel: contact, bias: 0.5}]\n")
    path = tmp_path / "a.mcap"
    assert run("probe", "--scenario", tmp_path / "own.yaml", "-o", path, *SHORT).exit_code == 0
    session = Session.open(path)
    assert "bias" not in session.metadata.scenario
    assert as_json("reveal", path)["hidden"][0]["parameters"] == {"bias": {"value": 0.5, "unit": "N"}}
    assert session.samples("tick")["force_n"][:200].mean() == pytest.approx(0.5, abs=0.01)


def test_named_effect_is_drawn_in_place_and_strength():
    (first,), (second,) = (hide(Scenario(seed=seed), "coulomb_friction").hidden for seed in (1, 2))
    assert first.name == second.name == "coulomb_friction"
    assert first != second
    assert hide(Scenario(seed=1), "coulomb_friction").hidden == (first,)


def test_session_without_hidden_effects_has_no_sealed_answer(probed):
    assert not sealed_path(probed[0]).exists()
    assert probed[1]["sealed"] is None
    told = done("reveal", probed[0])
    assert "has no hidden effects" in told.stdout
    assert ["probe", "--hidden", "random", "-o", "secret.mcap"] in next_commands(told)
    assert as_json("reveal", probed[0])["hidden"] == []


def test_merged_session_names_the_sessions_to_reveal(mystery, tmp_path):
    plain, both = tmp_path / "plain.mcap", tmp_path / "both.mcap"
    done("probe", "--seed", 9, "-o", plain, *SHORT)
    done("merge", mystery, plain, "-o", both)
    assert_refused(run("reveal", both), "merged from mystery.mcap, plain.mcap; reveal each of these")


def test_missing_or_foreign_answer_is_refused(mystery, tmp_path):
    """Two programs that probe at once to one name leave one whose time agrees, and its mark does not."""
    path = tmp_path / "a.mcap"
    path.write_bytes(mystery.read_bytes())
    assert_refused(run("reveal", path), "sealed answer", "a.mcap.sealed: no such file")
    metadata = Session.open(mystery).metadata
    seal(path, SealedAnswer((), 1, metadata.created_utc, "5" * 32))
    assert_refused(run("reveal", path), "another session")
    sealed_path(path).unlink()
    seal(path, SealedAnswer((), 1, "2001-01-01T00:00:00+00:00", metadata.extra[SEAL]))
    assert_refused(run("reveal", path), "another session, made at 2001")


def test_existing_answer_file_is_preserved_and_probing_is_refused(tmp_path):
    (tmp_path / "user.mcap.sealed").write_text("precious")
    result = run("probe", "--hidden", "bias", "-o", tmp_path / "user.mcap", *SHORT)
    assert_refused(result, "user.mcap.sealed: already exists")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [
        ("user.mcap.sealed", "precious")
    ]


def test_existing_session_gets_no_other_answer(tmp_path, mystery):
    """Whoever loses the race for the session's name seals nothing."""
    answer = sealed_path(mystery).read_text()
    job = ArmJob(find_robot("follower"), mystery, scenario=load_scenario({"hidden": BIAS}))
    with pytest.raises(SessionError, match="already exists"), arm_session(job, Calibrations(), {}):
        pass
    assert sealed_path(mystery).read_text() == answer
    assert run("reveal", mystery).exit_code == 0


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("gremlin", "no hidden effect is called 'gremlin'"),
        ("coulomb_frictoin", "did you mean 'coulomb_friction'"),
        ("contact_offset", "no probing run shows it"),
        ("none.yaml", "no such file"),
        ("hiden: []", "did you mean 'hidden'"),
        ("hidden: [{effect: bias, channel: contact}]", "bias: is missing"),
        ("hidden: [{effect: payload, joint: 4, mass_kg: 1}]", "joint 4 does not exist; the arm has 3 joints"),
    ],
)
def test_invalid_hidden_effects_are_refused(what, words, tmp_path):
    file = tmp_path / "hidden.yaml"
    file.write_text(what)
    given = file if ":" in what else what
    assert_refused(run("probe", "--hidden", given, "-o", tmp_path / "a.mcap", *SHORT), words)
    assert list(tmp_path.iterdir()) == [file]


def test_hidden_effects_require_the_simulator(tmp_path):
    robot = write_mock_files(tmp_path)
    options = ("--robot", robot, "--drivers", "tests.mock_robot", "--hidden", "random")
    assert_refused(run("probe", *options, "-o", tmp_path / "a.mcap"), "is not simulated", "hidden")
    arm = shutil.copytree(find_robot("follower").path.parent, tmp_path / "arm") / "follower.yaml"
    inline = "scenario: {hidden: [{effect: bias, channel: contact, bias: 1}]}"
    arm.write_text(arm.read_text().replace("scenario: default", inline))
    result = run("probe", "--robot", arm, "-o", tmp_path / "a.mcap", *SHORT)
    assert_refused(result, "buses.world.scenario.hidden", "belongs in a scenario file")


@pytest.mark.parametrize(("name", "channel"), [("coulomb_friction", "joint_3"), ("adhesion", "contact")])
def test_probing_finishes_with_any_hidden_effect(name, channel, tmp_path):
    scenario = load_scenario("default")
    entry = IMPERFECTIONS[name].at_strength(16.0, channel, noise_scale(scenario), np.random.default_rng(5))
    world = scenario.with_hidden([entry])
    job = ProbingJob(find_robot("follower"), tmp_path / "a.mcap", QUICK_RUN, scenario=world, online=None)
    outcome = run_probing(job)
    outcome.loop.raise_for_trip()
    assert outcome.failures == ()
    assert np.nanmax(Session.open(job.session).samples("tick")["force_n"]) > 9.5


def test_lagging_force_sensor_is_identified_from_a_joint(tmp_path, monkeypatch):
    """Every third tick is enough, and takes a thirtieth of the time."""
    try_few_effects(monkeypatch, "force_sensor_error")
    (tmp_path / "lag.yaml").write_text("hidden: [{effect: lag, channel: contact, time_s: 0.03}]\n")
    path = tmp_path / "lag.mcap"
    quick = ("--seed", 2, *SHORT, "--speed-mm-s", "150,100")
    run("probe", "--hidden", tmp_path / "lag.yaml", "-o", path, *quick)
    whole = open_source(path)
    thinned = tuple(channel.select(np.arange(0, len(channel), 3)) for channel in whole.channels)
    (found,) = Study(replace(whole, channels=thinned), keep=False).diagnose("joint_1").channels
    assert [one.effect for one in found.accepted] == ["force_sensor_error"]
    assert found.final.rmse < 0.3 * found.baseline.rmse
    assert found.remaining.depends_on == []


@pytest.mark.parametrize(
    ("stiffness_n_m", "time_s"), [(517.0, 0.093), (130.0, 0.485)], ids=["recovered", "still recovering"]
)
def test_free_surface_is_found_beside_the_error_of_a_detected_surface(tmp_path, stiffness_n_m, time_s):
    """The surface is found with an error of some tenths of a millimeter."""
    hidden = IMPERFECTIONS["stress_relaxation"](stiffness_n_m=stiffness_n_m, time_s=time_s)
    path, world = tmp_path / "relaxing.mcap", Scenario().with_hidden([hidden])
    run_probing(ProbingJob(find_robot(DEFAULT), path, ProbingPlan(), scenario=world, seed=1, online=None))
    study = ModelStudy(path)
    contact = study.channel("contact")
    sudden_n_m = 500.0 + stiffness_n_m
    assert not contact.data.recovers
    assert contact.data.recovery_ratio == pytest.approx(500.0 / sudden_n_m, rel=0.01)
    assert contact.data.retardation_s == pytest.approx(20.0 / sudden_n_m, rel=0.01)
    values = study.fit("contact", ["stress_relaxation"]).values
    assert values["stiffness.k"] == pytest.approx(500.0, rel=1e-3)
    assert values["stress_relaxation.tau"] == pytest.approx(time_s, rel=4e-3)
