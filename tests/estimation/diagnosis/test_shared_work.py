"""What is computed once for many models must be what each would compute by itself."""

from dataclasses import dataclass

import numpy as np
import pytest

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Parameter
from estimation.effects import EFFECTS
from estimation.fit import memory as memories
from estimation.fit.along import parts_along
from estimation.fit.memory import Memory
from estimation.fit.moments import held_out_energy, moments_of, score
from estimation.fit.standing import stand
from estimation.fit.trial import attempt
from estimation.model import Model
from tests.estimation.presses import session


def swings():
    """A joint that lifts more than its model knows, against friction, in four runs."""
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(4), 1500)
    t = np.tile(np.arange(1500) * 0.002, 4) + 5.0 * run
    rate = 3.0 + run
    q, v, a = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    own, per_kg = 2.0 * a + 3.0 * np.cos(q), 0.3 * a + 5.0 * np.cos(q)
    load = own + 0.4 * per_kg
    torque = load + 0.05 * np.abs(load) * np.tanh(v / 0.01) + 0.02 * rng.standard_normal(len(t))
    context = {"rigid_body_torque": own, "payload_effort_per_kg": per_kg}
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, v, a, torque, run, np.full(len(t), -1), context)


def test_models_that_share_their_work_are_fitted_as_by_themselves():
    """Also where the load, which one effect takes from the model around it, changes from model to model."""
    data, shared = swings(), Memory()
    rubbing, lifting = (EFFECTS[name]() for name in ("load_dependent_friction", "payload"))
    light = Model("rigid_body", (EFFECTS["rigid_body"](), rubbing, EFFECTS["coulomb_friction"]()))
    start = {"load_dependent_friction.transition": 0.01, "coulomb_friction.transition": 0.02}
    for model in (light, light.with_effect(lifting), light.without("coulomb_friction").with_effect(lifting)):
        together, alone = stand(data, model, start, memory=shared), stand(data, model, start)
        assert together.trial.parameters == pytest.approx(alone.trial.parameters, rel=1e-9)
        assert together.flexible.by_signal == pytest.approx(alone.flexible.by_signal, rel=1e-9, abs=1e-12)
    assert shared.size > 0
    assert alone.trial.parameters["payload.mass"] == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("scaled", [{}, {"torque_gain.gain": 0.8}])
def test_a_sum_is_fitted_on_blocks_as_it_is_sample_by_sample(scaled):
    data = swings()
    names = ("rigid_body", "payload", "viscous_friction", *(["torque_gain"] if scaled else []))
    model = Model("rigid_body", tuple(EFFECTS[name]() for name in names))
    assert model.is_sum
    bench = stand(data, model, scaled).plain
    found = attempt(bench, model, scaled)
    slopes, known = model.linearise(data, dict.fromkeys(model.gains, 0.0) | scaled)
    columns, target = bench.frame.reduce(slopes), bench.frame.reduce(data.effort - known)
    kept = bench.kept
    gains = np.linalg.lstsq(columns[kept], target[kept], rcond=None)[0]
    assert [found.parameters[name] for name in model.gains] == pytest.approx(gains, rel=1e-6)
    assert found.residual == pytest.approx(target - columns @ gains, abs=1e-7)


def test_what_was_asked_for_longest_ago_is_forgotten_first(monkeypatch):
    monkeypatch.setattr(memories, "MOST_BYTES", 3 * 80)
    memory, asked = Memory(), []

    def made(number):
        asked.append(number)
        return np.full(10, float(number))

    for number in (0, 1, 2, 0, 3, 0, 1):
        assert memory.recall(number, lambda n=number: made(n))[0] == number
    assert asked == [0, 1, 2, 3, 1]  # 1 had to go for 3, 0 had just been asked for again
    assert memory.size == 3 * 80


def test_errors_for_several_shrinkages_are_those_of_each():
    rng = np.random.default_rng(0)
    columns, fold = rng.normal(size=(300, 3)), rng.integers(0, 4, 300)
    moments = moments_of(columns, columns @ [1.0, 2.0, 3.0] + rng.normal(size=300), fold, 4)
    found = held_out_energy(moments, np.array([[1e-9] * 3, [0.1] * 3]))
    assert found[0] == pytest.approx(score(moments, 1e-9).held_out, rel=1e-9)
    assert found[1] == pytest.approx(score(moments, 0.1).held_out, rel=1e-9)


def test_parts_along_an_effect_are_those_of_the_whole_model_there():
    data = session(1)
    base = [EFFECTS[name]() for name in ("stiffness", "contact_offset", "stress_relaxation")]
    there = {"contact_offset.offset": 1e-3, "stress_relaxation.tau": 0.3}
    for name, inner in (("dry_friction", {"presliding": 1e-4}), ("lag", {"tau": 0.01})):
        effect = EFFECTS[name]()
        model = Model("m", (*base, effect))
        own = {f"{name}.{key}": value for key, value in inner.items()}
        found = parts_along(data, model, effect, {**there, **dict.fromkeys(own, 1.0)})(inner)
        for one, other in zip(found, model.parts(data, {**there, **own}), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)


def test_an_effect_that_is_a_dataclass_is_remembered_too_and_by_itself_alone():
    @dataclass  # equal by its values, and without a hash
    class Lift(AdditiveEffect):
        slope: float
        name = "lift"
        gains = (Parameter("a", "{effort}", -100.0, 100.0, (0.1, 1.0)),)

        def columns(self, data, inner):
            return self.slope * np.cos(data.position)[:, None]

    data, shared = swings(), Memory()
    for slope in (1.0, 1.0, 2.0):
        found = stand(data, Model("lift", (Lift(slope),)), {}, memory=shared).trial
        assert found.columns == pytest.approx(stand(data, Model("lift", (Lift(slope),)), {}).trial.columns)
