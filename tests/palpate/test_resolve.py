"""`palpate resolve`: the arm runs the separating experiment, and the study uses it."""

import json
from collections import OrderedDict

import numpy as np
import pytest
import yaml

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.design.next_experiment import NextExperiment, NextProbe
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.planning import experiments
from palpate.planning.experiments import (
    ArmText,
    KnownObject,
    PlanSimulation,
    candidates,
    simulate_plan,
    simulate_plans,
)
from palpate.planning.next_probe import feasible, next_probe, plan_text
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import open_answer
from palpate.runs.probing import PLAN, ProbingJob, run_probing
from palpate.runs.robots import find_robot
from palpate.study import Study
from palpate.workflows.resolve import DECISIONS, StopReason, resolve
from tests.palpate.cli import assert_refused, done, run

pytestmark = pytest.mark.slow

QUICK = ProbingPlan(hold_s=0.3)
PLACE = np.array([0.4, 0.0, 0.1])  # of the surface, about
SEED = 7206  # hides a dead band in joint 1, which a bias imitates as long as its torque keeps its sign


@pytest.fixture(scope="module")
def resolved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("resolved")
    told = []
    job = ProbingJob(
        find_robot("follower"), folder / "probe.mcap", QUICK, seed=SEED, hidden="deadband", online=None
    )
    return resolve(job, 3, 120.0, "joint_1", told.append), told


def test_second_probe_decides_between_rivals(resolved):
    done, told = resolved
    first, *_, last = done.decisions
    assert first.left["joint_1"] == [["bias", "deadband"]]
    assert first.next
    assert last.left == {"joint_1": [["deadband"]]}
    assert done.end is StopReason.SEPARATED
    assert told == list(done.decisions)


def test_sessions_share_hidden_effects_with_own_noise_and_log_decisions(resolved):
    done, _ = resolved
    logged = [json.loads(line) for line in (done.folder / DECISIONS).read_text().splitlines()]
    assert logged == json.loads(json.dumps(done.as_data()["decisions"]))
    assert [one["session"] for one in logged] == [path.name for path in sorted(done.folder.glob("*.mcap"))]
    first, second = (Session.open(path) for path in sorted(resolved[0].folder.glob("*.mcap"))[:2])
    assert open_answer(first).hidden == open_answer(second).hidden
    assert open_answer(first).seed == open_answer(second).seed == SEED
    assert first.metadata.seed != second.metadata.seed


def test_nothing_is_overwritten(resolved):
    before = {path: path.read_bytes() for path in resolved[0].folder.glob("*.mcap")}
    assert_refused(run("resolve", "--out", resolved[0].folder), "already holds sessions")
    assert {path: path.read_bytes() for path in resolved[0].folder.glob("*.mcap")} == before


def test_sessions_of_different_arms_are_no_single_measurement(resolved, tmp_path):
    for number, robot in enumerate(("follower", "leader")):
        job = ProbingJob(find_robot(robot), tmp_path / f"{number}.mcap", QUICK, seed=1, online=None)
        run_probing(job)
    with pytest.raises(InputError, match="not recorded with the arm of"):
        Study(tmp_path)


@pytest.fixture(scope="module")
def probed(resolved):
    return Study(sorted(resolved[0].folder.glob("*.mcap"))[0], keep=False)


def test_rehearsed_plan_moves_like_the_simulated_arm(probed):
    (candidate, ticks), *_ = feasible(probed)
    assert candidate.plan.speeds_m_s == QUICK.speeds_m_s
    measured = Session.open(probed.source.path).samples("tick")
    for name, tolerance in (("joint_position_rad", 0.002), ("force_n", 0.15)):
        for pick in (np.max, np.min):
            wanted = pick(measured[name], axis=0)
            assert pick(ticks[name], axis=0) == pytest.approx(wanted, abs=tolerance)


TILTED = QUICK.model_copy(update={"press_direction_world": (-0.64, 0.0, -0.77), "force_limit_n": 3.0})
TOO_HARD = QUICK.model_copy(update={"force_limit_n": 900.0})


@pytest.fixture(scope="module")
def simulations(probed):
    metadata = probed.source.session.metadata
    arm = ArmText(metadata.robot_file, metadata.urdf, probed.source.arm.gravity_m_s2, "here")
    known = KnownObject(500.0, 20.0, -0.05, (0.0, 0.0, -1.0))
    start_rad = tuple(probed.source.session.samples("tick")["joint_position_rad"][0].tolist())
    return [PlanSimulation(arm, one.model_dump_json(), known, start_rad) for one in (QUICK, TOO_HARD, TILTED)]


def test_plan_simulations_do_not_depend_on_the_number_of_processes(simulations, monkeypatch):
    made = []
    for processes in (2, 1):
        monkeypatch.setattr(experiments, "_known", OrderedDict())
        made.append(list(simulate_plans(simulations, processes)))
    for there, here in zip(*made, strict=True):
        assert (there is None) == (here is None)
        assert here is None or all(np.array_equal(there[name], here[name]) for name in here.columns)
    assert [one is None for one in made[0]] == [False, True, False]  # what the arm cannot do
    assert list(simulate_plans(simulations)) == made[1]  # is remembered


def test_simulated_plan_obeys_the_equation_of_motion(simulations):
    """One that followed its task at once would turn round faster than any arm, and show what none shows."""
    ticks, body = simulate_plan(simulations[2]), simulations[2].arm.body
    dt_s, position = ticks["time_s"][1] - ticks["time_s"][0], ticks["joint_position_rad"]
    velocity = np.diff(position, axis=0) / dt_s
    acceleration = np.diff(velocity, axis=0) / dt_s
    needed = body.inverse_dynamics_batch(position[1:-1], velocity[:-1], acceleration)
    in_air = ticks["force_n"][1:-1] == 0.0
    assert in_air.sum() > 1000
    assert needed[in_air] == pytest.approx(ticks["torque_measured_nm"][1:-1][in_air], abs=1e-6)


def test_infeasible_experiments_are_not_proposed(probed):
    robot = find_robot("follower")
    offered = {candidate.words for candidate, _ in feasible(probed)}
    assert offered < {candidate.words for candidate in candidates(QUICK, robot, PLACE)}
    strongest = max(candidate.plan.force_limit_n for candidate in candidates(QUICK, robot, PLACE))
    assert strongest < robot.limits.force_n


def test_other_places_are_rehearsed_only_on_request(probed):
    assert {candidate.is_new_location for candidate, _ in feasible(probed)} == {True, False}
    assert {candidate.is_new_location for candidate, _ in feasible(probed, elsewhere=False)} == {False}


@pytest.fixture(scope="module")
def diagnosed(probed):
    return probed.diagnose("joint_1")


def test_experiment_longer_than_the_remaining_time_is_not_chosen(probed, diagnosed):
    assert next_probe(probed, diagnosed.channels, longest_s=0.5) is None


def test_diagnosis_proposes_the_plan_that_resolve_would_run(probed, diagnosed, tmp_path):
    following = next_probe(probed, diagnosed.channels)
    assert set(following.proposal.separates) == {"deadband", "bias"}
    assert diagnosed.channels[0].next_experiment == following.proposal
    assert probed.next_probe(diagnosed.channels).plan == following.plan
    (tmp_path / "next.yaml").write_text(plan_text(following.proposal, following.plan))
    assert ProbingPlan.load(tmp_path / "next.yaml") == following.plan


def test_saved_diagnosis_is_followed_as_stated(probed, diagnosed, monkeypatch):
    """The page opens a study anew: it runs what the terminal printed, and plans nothing again."""
    monkeypatch.setattr(experiments, "simulate_plan", lambda _: pytest.fail("was planned again"))
    saved = [ChannelDiagnosis.model_validate_json(one.model_dump_json()) for one in diagnosed.channels]
    following = Study(probed.source.path, keep=False).next_probe(saved)
    assert following.proposal == diagnosed.channels[0].next_experiment
    assert following.plan == probed.next_probe(diagnosed.channels).plan


def test_plan_from_a_foreign_file_is_not_executed(probed, diagnosed):
    (stated,) = diagnosed.channels
    foreign = stated.next_experiment.model_copy(update={"probe": {"force_limit_n": 14.0, "repeats": 40}})
    opened = Study(probed.source.path, keep=False)
    following = opened.next_probe([stated.model_copy(update={"next_experiment": foreign})])
    assert following is None or following.plan in [candidate.plan for candidate, _ in feasible(opened)]


def test_no_experiment_is_run_twice(resolved, diagnosed):
    sessions = [Session.open(path) for path in sorted(resolved[0].folder.glob("*.mcap"))]
    following = next_probe(Study(resolved[0].folder, keep=False), diagnosed.channels)
    assert len({one.metadata.extra[PLAN] for one in sessions}) == len(sessions) > 1
    assert following is None or following.plan not in [
        ProbingPlan(**yaml.safe_load(one.metadata.extra[PLAN])) for one in sessions
    ]


def test_separation_is_withdrawn_with_further_data(tmp_path, diagnosed, monkeypatch):
    (shown,) = diagnosed.channels
    gone = shown.model_copy(update={"verdict": Verdict.ADEQUATE, "accepted": []})
    answers = iter([diagnosed, diagnosed.model_copy(update={"channels": [gone]})])
    monkeypatch.setattr(Study, "diagnose", lambda *_, **__: next(answers))
    proposal = NextExperiment(purpose="p", separates=[], instruction="i", probe={})
    again = NextProbe(QUICK, proposal, "why", ("joint_1",))
    job = ProbingJob(find_robot("follower"), tmp_path / "r" / "p.mcap", QUICK, seed=SEED, online=None)
    done = resolve(job, 2, 120.0, "joint_1", design=lambda *_: again)
    assert [one.end for one in done.decisions] == [None, StopReason.UNSEEN]


@pytest.mark.parametrize("named", [True, False])
def test_only_named_effects_are_called_inseparable(tmp_path, diagnosed, named, monkeypatch):
    (shown,) = diagnosed.channels
    left = shown.model_copy(update={"verdict": Verdict.UNEXPLAINED, "accepted": [], "complete": False})
    said = diagnosed if named else diagnosed.model_copy(update={"channels": [left]})
    monkeypatch.setattr(Study, "diagnose", lambda *_, **__: said)
    monkeypatch.setattr(Study, "settle", lambda study, judged, probe: list(judged))
    job = ProbingJob(find_robot("follower"), tmp_path / "r" / "p.mcap", QUICK, seed=SEED, online=None)
    (decision,) = resolve(job, 2, 120.0, "joint_1", design=lambda *_: None).decisions
    assert decision.end in (
        {StopReason.INSEPARABLE, StopReason.SIMPLEST} if named else {StopReason.UNEXPLAINED}
    )


def test_without_budget_the_first_probe_is_the_last(tmp_path, diagnosed, monkeypatch):
    monkeypatch.setattr(Study, "diagnose", lambda *_, **__: diagnosed)
    options = ("--seed", SEED, "--channel", "joint_1", "--probes", 1, "--out", tmp_path / "r", "--json")
    result = done("resolve", "--hidden", "deadband", *options)
    said = json.loads(result.stdout)
    assert (said["end"], said["probes"]) == ("probes", 1)
    assert "budget" in result.stderr


def test_ctrl_c_states_the_session_folder(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Study, "diagnose", interrupted)
    result = run("resolve", "--seed", SEED, "--out", tmp_path / "r")
    assert result.exit_code != 0
    assert f"kept: {tmp_path / 'r'}" in " ".join(result.stderr.split())
    assert (tmp_path / "r" / "probe-01.mcap").exists()


@pytest.mark.parametrize(
    "options",
    [
        ("--probes", 0),
        ("--seconds", -1),
        ("--experiment", "none.yaml"),
        ("--channel", "nope"),
        ("--channel", "contact_7"),
    ],
)
def test_a_bad_option_is_refused_before_anything_moves(tmp_path, options):
    assert_refused(run("resolve", *options, "--out", tmp_path / "r"), str(options[0]).strip("-"))
    assert not (tmp_path / "r").exists()
