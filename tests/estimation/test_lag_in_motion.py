"""A sensor with a lag, in recordings that begin while the arm moves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.design.discrimination import RivalModels
from palpate.estimation.diagnosis.candidates import is_misnamed
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from tests.estimation.searches import ROTOR, reached, searched

INERTIA, DAMPING, NOISE_NM = 0.2, 0.5, 1e-3


def motion(t, phase):
    """Angle, velocity and acceleration of a rotor that never rests."""
    slow, fast = 4.0 * t + phase, 11.0 * t + 3.0 * phase
    return (
        np.sin(slow) + 0.2 * np.sin(fast),
        4.0 * np.cos(slow) + 2.2 * np.cos(fast),
        -16.0 * np.sin(slow) - 24.2 * np.sin(fast),
    )


def torque(t, phase):
    _, velocity, acceleration = motion(t, phase)
    return INERTIA * acceleration + DAMPING * velocity


def lagging(t, phase, tau_s=0.15):
    """Reading of a first-order sensor that has followed the torque for five seconds, by integration."""
    ends = t[0] - 5.0, t[-1]
    moved = solve_ivp(
        lambda at, y: (torque(at, phase) - y) / tau_s, ends, [0.0], t_eval=t, rtol=1e-9, atol=1e-9
    )
    return moved.y[0]


def recording(read, runs=4):
    """Runs of 2 s of a moving rotor; the reading of its torque is `read(time, phase)`."""
    t, phases = np.tile(np.arange(0.0, 2.0, 0.005), (runs, 1)), 1.5 * np.arange(runs)[:, None]
    effort = np.concatenate([read(times, phase) for times, phase in zip(t, phases[:, 0], strict=True)])
    effort += np.random.default_rng(4).normal(0.0, NOISE_NM, len(effort))
    run = np.repeat(np.arange(runs), t.shape[1])
    signals = t.ravel(), *(each.ravel() for each in motion(t, phases))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, *signals, effort, run, np.full(len(run), -1))


def test_lag_is_recovered_although_each_run_begins_in_motion():
    fit = reached(searched(recording(lagging), "lag", base=ROTOR), "lag")
    for name, truth in {"lag.tau": 0.15, "inertia.m": INERTIA, "viscous_friction.d": DAMPING}.items():
        assert fit.parameters[name].value == pytest.approx(truth, rel=2e-3)
    assert fit.rmse < 1.05 * NOISE_NM


def test_planned_motion_begins_with_a_settled_sensor():
    """It has no readings; zero in their place would leave a transient that no experiment shows."""
    data = recording(lagging)
    search = searched(data, "lag", "delay", base=ROTOR)
    rivals = RivalModels.of([reached(search, name) for name in ("lag", "delay")])
    planned = replace(data, effort=np.zeros(len(data)))
    simulated = rivals.simulated_leads(planned, np.random.default_rng(0))
    np.testing.assert_allclose(rivals.predicted_leads(planned)[0], simulated[0], atol=1e-3)  # of the lag


@pytest.mark.parametrize("order", [("torque_gain", "lag"), ("lag", "torque_gain")])
def test_fit_on_blocks_agrees_with_the_prediction_in_any_order_of_sensors(order):
    data = recording(lagging)
    model = Model("rotor", (*ROTOR.effects, *(EFFECTS[name]() for name in order)))
    held = replace(model, held={"torque_gain.gain": 2.0})
    problem = fit_model(data, ROTOR, {}).problem
    solution = solve_gains(problem, held, {"lag.tau": 0.15, "torque_gain.gain": 2.0})
    residual = data.effort - held.predict(data, solution.parameters)
    np.testing.assert_allclose(solution.residual, problem.blocked.reduce(residual), atol=1e-9)


@pytest.mark.parametrize(("law", "tau_s", "is_lag"), [(lagging, 0.15, True), (torque, 0.1, False)])
def test_relaxing_error_of_each_run_is_no_lag(law, tau_s, is_lag):
    """It is an exponential from the first reading on, as the response of a lag to motion before the run."""
    relaxing = 0.0 if is_lag else 1.0
    data = recording(lambda t, phase: law(t, phase) + relaxing * np.exp(-t / 0.1))
    problem, model = fit_model(data, ROTOR, {}).problem, ROTOR.with_effect(EFFECTS["lag"]())
    solution = solve_gains(problem, model, {"lag.tau": tau_s})
    assert is_misnamed(model.effect("lag"), solution, problem) is not is_lag
