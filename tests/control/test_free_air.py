"""A force limit means nothing to a sensor that cannot tell a touch, or that is pressed already."""

import numpy as np
import pytest

from control.laws.gains import Gains, TouchGains
from control.loop.phases import Phase
from control.probing.plan import ProbingPlan
from robot_io.errors import InputError
from tests.control.probing_runs import plant_above, probing_task, run_probing


def probe(gains: Gains | None = None, height_m: float = 0.08, plan=None, **plant):
    plant = plant_above(height_m=height_m, stiffness_n_m=2000.0, damping_n_s_m=20.0, **plant)
    task = probing_task(ProbingPlan(**{"speeds_m_s": (0.15,), "hold_s": 0.1} | (plan or {})), gains)
    return run_probing(plant, task), task


@pytest.mark.parametrize(
    ("noise_n", "limit_n", "least_n"), [(0.8, 10.0, 13.7), (1.0, 10.0, 17.1), (0.35, 4.0, 6.0)]
)
def test_a_sensor_too_noisy_for_the_force_limit_presses_nothing(noise_n, limit_n, least_n):
    record, task = probe(force_noise_n=noise_n, plan={"force_limit_n": limit_n, "speeds_m_s": (0.15, 0.09)})
    assert record.kinds() == ["free_air", "free_air_refused", "probing_done"]
    assert record.force_n.max() == 0.0
    assert Phase.APPROACH not in record.phase
    (failure,) = task.failures  # and the second speed is not tried
    assert f"with force_limit_n {limit_n:g} N at most {0.35 * limit_n:.3g} N" in failure
    needed_n = float(failure.split("a force_limit_n of ")[1].split(" N")[0])
    assert needed_n == pytest.approx(least_n, rel=0.1)  # six standard deviations over 0.35
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3


def test_the_force_limit_that_the_refusal_names_is_enough():
    record, task = probe(force_noise_n=0.8, plan={"force_limit_n": 15.0})
    assert task.failures == ()
    assert record.kinds()[-1] == "probing_done"
    assert 0.0 < record.force_n.max() < 19.0  # found late, by what the noise hides


@pytest.mark.parametrize("force_n", [30.0, 6.0, -6.0])
def test_a_force_before_the_arm_moves_is_not_tared_away(force_n):
    plant = plant_above(force_bias_n=force_n)
    task = probing_task(ProbingPlan())
    with pytest.raises(InputError, match=rf"{force_n:g} N in free air.* at most 5 N: is the tool touched"):
        task.start(plant.measure())


def test_a_touch_force_above_the_plan_s_share_is_refused_before_the_arm_moves():
    task = probing_task(ProbingPlan(force_limit_n=10.0), Gains(touch=TouchGains(touch_force_n=4.0)))
    with pytest.raises(InputError, match=r"counts from 4 N on.* at most 3.5 N.*touch_force_n"):
        task.start(plant_above().measure())


def test_an_object_that_came_under_the_tool_is_not_tared_away_either():
    """From 4 N, which is the sensor's own, to 6 N, which is not."""
    plant = plant_above(force_bias_n=4.0)
    task = probing_task(ProbingPlan(speeds_m_s=(0.15,)))
    truth = plant.measure

    def measure():
        measurement = truth()
        pushed_n = 2.0 if plant.time_s > 0.1 else 0.0
        return measurement._replace(force_n=measurement.force_n + pushed_n)

    plant.measure = measure
    record = run_probing(plant, task)
    assert record.kinds() == ["free_air", "free_air_refused", "probing_done"]
    assert "6 N in free air" in task.failures[0]
    assert record.force_n.max() == 0.0


def test_how_much_may_be_there_is_the_robot_file_s_to_say():
    gains = Gains(touch=TouchGains(bias_share=0.8, limit_share=0.6))
    record, task = probe(gains, force_bias_n=6.0, force_noise_n=0.7)
    assert task.failures == ()
    assert record.kinds()[-1] == "probing_done"


def test_controller_and_estimation_share_one_rule_of_touch(monkeypatch):
    monkeypatch.setattr("control.laws.touch._NOISE_FACTOR", 12.0)
    monkeypatch.setattr(
        "control.laws.hybrid.release_force_n", lambda touch_n, _gains: released_below.append(touch_n) or 0.1
    )
    released_below: list[float] = []
    record, _ = probe(force_noise_n=0.1)
    assert record.event("free_air").data["touch_n"] == pytest.approx(1.2, rel=0.1)
    assert released_below[-1] == record.event("free_air").data["touch_n"]
    assert record.event("release").data["force_n"] < 0.1
