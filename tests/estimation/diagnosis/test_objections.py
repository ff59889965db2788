"""What speaks against a model that leaves nothing to a smooth law, and what is only noise."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.data.derivatives import differentiate
from estimation.diagnosis.objections import disagreement, objection_to
from estimation.fit.readings import readings_of
from estimation.fit.standing import stand
from estimation.models import MODELS
from tests.estimation.presses import NOISE_N, kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def louder_with_load(seed):
    data = session(seed)
    noise = np.random.default_rng(seed).normal(0.0, 0.05, len(data)) * np.abs(data.effort)
    return replace(data, effort=data.effort + noise)


def coarsely_read(seed, step_m=3e-4):
    data = session(seed)
    return replace(data, position=step_m * np.round(data.position / step_m))


def derived_from_steps(seed):
    """The speed's error is slow where two encoders step, and damping makes a force of it."""
    data = session(seed)
    x, v = 0.02 * data.position, 0.02 * data.velocity
    noise = np.random.default_rng(seed).normal(0.0, 0.02, len(data))
    read = sum(share * step * np.round(share * x / step) for share, step in ((0.8, 4e-6), (0.6, 7e-6)))
    motion = differentiate(data.time_s, read, data.run)
    force = np.where(x > 0.0, np.maximum(15e3 * x + 4e3 * v, 0.0), 0.0) + noise
    return replace(
        data, position=read, velocity=motion.velocity, acceleration=motion.acceleration, effort=force
    )


NOISE = {
    "white": session,
    "slow": lambda seed: session(seed, correlation=0.9),
    "very slow": lambda seed: session(seed, correlation=0.97),
    "growing with the load": louder_with_load,
    "steps of the depth": coarsely_read,
    "a speed derived from steps": derived_from_steps,
}


def objection(data):
    readings, rng = readings_of(data), np.random.default_rng(0)
    return objection_to(stand(data, MODEL, {}), readings, rng, complete=True)


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_no_objection(name):
    assert [objection(NOISE[name](seed)) for seed in range(4)] == [None] * 4


@pytest.mark.parametrize("length", [None, 60])
def test_a_run_of_another_scale_is_found_also_beside_one_too_short_to_be_judged(length):
    def scaled(t, x, v, run):
        return kelvin_voigt(x, v) * np.where(run == 2, 1.2, 1.0)

    data = session(6, scaled)
    if length:
        last = data.run == data.runs[-1]
        data = data.select(~last | (np.cumsum(last) <= length))
    assert "run 2 is off" in objection(data).reason
    fitted = stand(data, MODEL, {})
    found = disagreement(fitted.plain.frame, fitted.trial)
    assert found.run == 2
    assert found.run_alone < 1.2 * NOISE_N < found.run_predicted


def test_a_swing_of_its_own_in_each_run_is_told_with_its_size_and_what_is_left_beside_it():
    data, size_n = session(7), 0.05
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, int(data.run.max()) + 1)
    swung = data.effort + size_n * np.sin(2.0 * np.pi * 7.0 * data.time_s + phase[data.run])
    found = objection(replace(data, effort=np.where(data.effort > 5 * NOISE_N, swung, data.effort)))
    frequency_hz, told_n = (float(found.reason.split(word)[0].split()[-1]) for word in (" Hz", " N,"))
    assert frequency_hz == pytest.approx(7.0, rel=0.02)
    assert told_n == pytest.approx(size_n / np.sqrt(2.0), rel=0.15)
    assert found.depends_on == "time"
    assert found.floor == pytest.approx(NOISE_N, rel=0.2)
