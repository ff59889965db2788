"""Probing plans: order of runs, and refusals by the plan, the guard, or in free air."""

import numpy as np
import pytest

from palpate.control.laws.gains import Gains, TouchGains
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import Phase
from palpate.control.paths.excitation import Excitation
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file
from tests.control.probing_runs import plant_above, probing_task, push, run_probing, started
from tests.control.simulated_arms import ARMS, SimulatedArm, kelvin_voigt
from tests.files import saved

TARGETS = ((0.4, 0.0, 0.05), (0.42, 0.0, 0.05))
FOLLOWER = load_robot_file(ARMS / "follower" / "follower.yaml")  # trips at 60 N and 6 rad/s


def test_every_target_gets_every_repeat_of_every_speed_and_a_unit_direction():
    runs = ProbingPlan(speeds_m_s=(0.1, 0.05), repeats=2, targets_world_m=TARGETS).runs()
    assert [run.run for run in runs] == list(range(8))
    assert [run.target for run in runs] == [0] * 4 + [1] * 4
    assert [run.speed_m_s for run in runs] == [0.1, 0.05] * 4
    assert [run.target for run in ProbingPlan().runs()] == [0, 0, 0]
    assert ProbingPlan(press_direction_world=(0, 0, -3)).press_direction_world == (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speeds_m_s: []", "plan.yaml line 1, speeds_m_s"),
        ("speeds_m_s: [0.1, -0.1]", "speeds_m_s entry 2: .*greater than 0"),
        ("speeds_m_s: [10]", "speeds_m_s entry 1: .*less than or equal to 1 "),
        ("force_limit: 5", "force_limit: .*did you mean 'force_limit_n'"),
        ("force_limit_n: 1e-300", "force_limit_n: .*greater than or equal to 0.01"),
        ("press_direction_world: [0, 0, 0]", "has no direction"),
        ("excitation: {amplitude_n: 4.5}", r"at most 4 N for force_limit_n 10\.0 N"),
        ("{speeds_m_s: [0.5], acceleration_m_s2: 2}", r"approach_clearance_m 0\.03 m .*at least 0\.0938 m"),
        ("retract_m: 0.002", "retract_m 0.002 m is too short"),
    ],
)
def test_invalid_plan_is_one_clear_line(text, message, tmp_path):
    with pytest.raises(InputError, match=message) as caught:
        ProbingPlan.load(saved(tmp_path / "plan.yaml", text + "\n"))
    assert "\n" not in str(caught.value)


def test_shortest_time_counts_every_run():
    plan = ProbingPlan(
        speeds_m_s=(0.1, 0.05),
        repeats=3,
        hold_s=2.0,
        settle_s=0.5,
        free_air_s=0.25,
        approach_clearance_m=0.05,
    )
    assert plan.shortest_s == pytest.approx(3 * (0.5 + 1.0 + 2 * 2.75))
    assert len(plan.runs()) == 6


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ({"force_limit_n": 100.0}, r"force_limit_n 100 N: .*'follower' trips at 60 N .*at most 54.5 N"),
        ({"force_limit_n": 58.0}, "at most 54.5 N"),  # it would trip on the first overshoot
        ({"joint_speed_rad_s": 7.0}, r"joint_speed_rad_s 7: .* trips at 6 rad/s .*at most 5.45 rad/s"),
    ],
)
def test_plan_beyond_guard_limits_is_refused_in_one_line(plan, message):
    with pytest.raises(InputError, match=message) as refused:
        ProbingTask.from_robot_file(FOLLOWER, ProbingPlan(**plan))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "plan",
    [
        {"force_limit_n": 54.0, "joint_speed_rad_s": 5.4},
        {"force_limit_n": 54.0, "excitation": Excitation(quantity="position", amplitude_n=10.0)},
    ],
)
def test_plan_within_guard_limits_is_not_refused(plan):
    ProbingTask.from_robot_file(FOLLOWER, ProbingPlan(**plan))


def test_force_excitation_never_exceeds_the_limit():
    ride = Excitation(quantity="force", amplitude_n=15.0, duration_s=2.0, high_hz=4.0)
    plan = ProbingPlan(speeds_m_s=(0.05,), force_limit_n=54.0, hold_s=0.2, excitation=ride)
    arm = SimulatedArm("follower", plan, kelvin_voigt(5000.0))
    result = arm.run()
    assert result.outcome is Outcome.FINISHED, result.cause
    excited_s = next(time_s for time_s, kind, _ in arm.log.events if kind == "excitation")
    excited = (arm.truth[:, 0] > excited_s + 0.1) & (arm.truth[:, 0] < excited_s + 2.0)
    forces = arm.truth[excited, 2]
    assert forces.min() < 30.0
    assert forces.max() < 54.5


@pytest.mark.parametrize(
    ("plan", "name"),
    [({"speeds_m_s": (0.1, 0.3)}, "speeds_m_s 0.3"), ({"travel_speed_m_s": 0.4}, "travel_speed")],
)
def test_speeds_beyond_a_joint_limit_are_refused_at_the_start(plan, name):
    started(ProbingPlan(**plan), velocity_limits_rad_s=np.full(3, 4.0))
    with pytest.raises(InputError, match=rf"{name}.* target 1 joint \d would move .* trips at 0.5 rad/s"):
        started(ProbingPlan(**plan), velocity_limits_rad_s=np.full(3, 0.5))


def probe(gains: Gains | None = None, height_m: float = 0.08, plan=None, **plant):
    plant = plant_above(height_m=height_m, stiffness_n_m=2000.0, damping_n_s_m=20.0, **plant)
    task = probing_task(ProbingPlan(**{"speeds_m_s": (0.15,), "hold_s": 0.1} | (plan or {})), gains)
    return run_probing(plant, task), task


@pytest.mark.parametrize(
    ("noise_n", "limit_n", "least_n"), [(0.8, 10.0, 13.7), (1.0, 10.0, 17.1), (0.35, 4.0, 6.0)]
)
def test_sensor_too_noisy_for_the_force_limit_presses_nothing(noise_n, limit_n, least_n):
    record, task = probe(force_noise_n=noise_n, plan={"force_limit_n": limit_n, "speeds_m_s": (0.15, 0.09)})
    assert record.kinds() == ["free_air", "free_air_refused", "probing_done"]
    assert record.force_n.max() == 0.0
    assert Phase.APPROACH not in record.phase
    (failure,) = task.failures  # and the second speed is not tried
    assert f"with force_limit_n {limit_n:g} N, at most {0.35 * limit_n:.3g} N" in failure
    needed_n = float(failure.split("raise force_limit_n to ")[1].split(" N")[0])
    assert needed_n == pytest.approx(least_n, rel=0.1)  # six standard deviations over 0.35
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3


def test_force_limit_named_by_the_refusal_is_enough():
    record, task = probe(force_noise_n=0.8, plan={"force_limit_n": 15.0})
    assert task.failures == ()
    assert record.kinds()[-1] == "probing_done"
    assert 0.0 < record.force_n.max() < 19.0  # found late, by what the noise hides


@pytest.mark.parametrize("force_n", [30.0, 6.0, -6.0])
def test_force_before_motion_is_not_tared_away(force_n):
    plant = plant_above(force_bias_n=force_n)
    task = probing_task(ProbingPlan())
    with pytest.raises(InputError, match=rf"force in free air is {force_n:g} N.* at most 5 N is allowed; "):
        task.start(plant.measure())


def test_robot_file_limits_the_force_before_motion():
    task = probing_task(ProbingPlan(force_limit_n=10.0), Gains(touch=TouchGains(touch_force_n=4.0)))
    with pytest.raises(
        InputError, match=r"would be detected only above 4 N.* at most 3.5 N is allowed.*touch_force_n"
    ):
        task.start(plant_above().measure())
    gains = Gains(touch=TouchGains(bias_share=0.8, limit_share=0.6))
    record, task = probe(gains, force_bias_n=6.0, force_noise_n=0.7)
    assert task.failures == ()
    assert record.kinds()[-1] == "probing_done"


def test_contact_during_free_air_is_not_tared():
    """From 4 N, which is the sensor's own, to 6 N, which is not."""
    plant = plant_above(force_bias_n=4.0)
    task = probing_task(ProbingPlan(speeds_m_s=(0.15,)))
    push(plant, lambda: 2.0 if plant.time_s > 0.1 else 0.0)
    record = run_probing(plant, task)
    assert record.kinds() == ["free_air", "free_air_refused", "probing_done"]
    assert "the force in free air is 6 N" in task.failures[0]
    assert record.force_n.max() == 0.0


def test_controller_and_estimation_share_one_touch_rule(monkeypatch):
    monkeypatch.setattr("palpate.control.laws.touch._NOISE_FACTOR", 12.0)
    monkeypatch.setattr(
        "palpate.control.laws.hybrid.release_force_n",
        lambda touch_n, _gains: released_below.append(touch_n) or 0.1,
    )
    released_below: list[float] = []
    record, _ = probe(force_noise_n=0.1)
    assert record.event("free_air").data["touch_n"] == pytest.approx(1.2, rel=0.1)
    assert released_below[-1] == record.event("free_air").data["touch_n"]
    assert record.event("release").data["force_n"] < 0.1
