"""Position servos whose effort nobody measured: goal minus position, by the model `position_servo`.

The servo here is simulated by itself: voltage of a firmware's gain, back-EMF, friction that sticks, a gap.
"""

import math
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.robot_io.errors import InputError
from palpate.study import Study
from tests.few_effects import try_few_effects
from tests.palpate.presses import write_table

GAIN_V_RAD, KT, OHM, INERTIA = 20.0, 1.28, 2.75, 0.03  # firmware gain times supply; motor; load and rotor
STIFF = GAIN_V_RAD * KT / OHM  # torque per goal error [N m/rad]
VISCOUS = 0.03
STEP_S, EVERY = 5e-4, 20


@cache
def servo(seed, dry=0.0, weight=0.0, gap=0.0, seconds=12.0):
    """Goal and position of a servo that follows three sines, with 0.3 mrad of noise; columns t, goal, q."""
    rng = np.random.default_rng(seed)
    size, phase = np.array([0.5, 0.25, 0.1]), rng.uniform(0.0, 6.0, 3)
    rate = rng.uniform([0.8, 2.0, 4.0], [1.6, 3.5, 6.0])
    times = STEP_S * np.arange(int(seconds / STEP_S))
    goals = (np.sin(np.outer(times, rate) + phase) @ size).tolist()
    q, v, rows = goals[0], 0.0, []
    link = q  # of a load that friction holds within the gap
    for step, goal in enumerate(goals):  # plain numbers: 24,000 steps
        if step % EVERY == 0:
            rows.append((times[step], goal, q))
        motor = KT / OHM * (GAIN_V_RAD * (goal - q) - KT * v) - VISCOUS * v - weight * math.sin(link)
        pushed = v + STEP_S * motor / INERTIA
        v = math.copysign(max(abs(pushed) - STEP_S * dry / INERTIA, 0.0), pushed)
        q += STEP_S * v
        link = min(max(link, q - 0.5 * gap), q + 0.5 * gap)
    table = np.array(rows)[100:]  # the start from rest is over
    table[:, 2] += rng.normal(0.0, 3e-4, len(table))
    return table


def written(folder, count=4, **settings):
    runs = [servo(seed, **settings) for seed in range(count)]
    t, goal, q = np.concatenate(runs).T
    run = np.repeat(np.arange(count), len(runs[0]))
    return write_table(folder / "servo.csv", time_s=t, run=run, goal_position_rad=goal, position_rad=q)


def test_hidden_dry_friction_is_named_with_its_size_in_goal_error(tmp_path, monkeypatch):
    try_few_effects(monkeypatch, "stribeck_friction", "quadratic_friction", "backlash")
    study = Study(written(tmp_path, dry=0.15, seconds=8.0), keep=False)
    (channel,) = study.channels
    assert (channel.kind, channel.model.name) == (ChannelKind.SERVO, "position_servo")
    (found,) = study.diagnose().channels
    assert [entry.effect for entry in found.accepted] == ["coulomb_friction"]
    force = found.accepted[0].parameters["force"]
    assert force.unit == "rad"
    assert force.value == pytest.approx(0.15 / STIFF, rel=0.05)
    damping = found.final.parameters["viscous_friction.d"]
    assert damping.value == pytest.approx((VISCOUS + KT**2 / OHM) / STIFF, rel=0.05)
    inertia = found.final.parameters["inertia.m"]
    assert (inertia.unit, inertia.value) == ("s^2", pytest.approx(INERTIA / STIFF, rel=0.2))


def test_hidden_payload_is_identified_from_the_goal_error(tmp_path):
    study = Study(written(tmp_path, weight=0.9, seconds=8.0), keep=False)
    study.add("weight")
    (result,) = study.results()
    parameters = result.stages[-1].parameters
    assert parameters["weight.g1"].value == pytest.approx(0.9 / STIFF, rel=0.03)
    assert parameters["weight.g1"].unit == "rad"


@pytest.mark.slow
def test_hidden_backlash_is_identified_with_gravity_load(tmp_path):
    (found,) = Study(written(tmp_path, weight=3.0, gap=0.08), keep=False).diagnose().channels
    assert {"weight", "backlash"} <= {entry.effect for entry in found.accepted}
    gap = found.final.parameters["backlash.gap"]
    assert (gap.unit, gap.value) == ("rad", pytest.approx(0.08, rel=0.1))


def lerobot(folder, **arrays):
    t, goal, q = np.concatenate([servo(seed, seconds=6.0) for seed in range(2)]).T
    columns = {"timestamp": t, "episode_index": np.repeat([0, 1], len(t) // 2)}
    columns |= {"action": np.degrees(goal)[:, None].tolist()}
    columns |= {"observation.state": np.degrees(q)[:, None].tolist()} | arrays
    pq.write_table(pa.table(columns), folder / "episode.parquet")
    return folder / "episode.parquet", goal, q


def test_lerobot_data_without_currents_use_the_goal_error_as_effort(tmp_path):
    path, goal, q = lerobot(tmp_path)
    imported = import_file(path, ImportOptions(units={"position": "deg", "goal": "deg"}))
    (channel,) = imported.channels
    assert channel.kind is ChannelKind.SERVO
    assert channel.effort == pytest.approx(goal - q)
    assert any("position_servo" in note for note in imported.notes)
    with pytest.raises(InputError, match="--unit"):
        import_file(path)


def test_measured_effort_is_preferred_to_the_goal_error(tmp_path):
    path, _, q = lerobot(tmp_path, **{"observation.effort": (0.1 * np.ones((1000, 1))).tolist()})
    imported = import_file(path, ImportOptions(units={"position": "deg", "torque": "Nm"}))
    assert imported.channels[0].kind is ChannelKind.REVOLUTE
    assert len(q) == 1000


def test_model_applies_to_servos_alone(tmp_path):
    path = written(tmp_path, 2, seconds=6.0)
    with pytest.raises(InputError, match="position_servo"):
        Study(path, "inertia_of_nothing", keep=False)
    study = Study(path, "position_servo", keep=False)
    with pytest.raises(InputError, match="goal error"):
        study.export_simulator(tmp_path / "actuators.py", "isaaclab")
    assert not (tmp_path / "actuators.py").exists()
    assert study.channels[0].model.name == "position_servo"


def test_export_names_a_column_that_makes_it_possible(tmp_path):
    t, goal, q = np.concatenate([servo(seed, seconds=6.0) for seed in range(2)]).T
    columns = {
        "time_s": t,
        "run": np.repeat([0, 1], len(t) // 2),
        "goal_position_rad": goal,
        "position_rad": q,
    }
    target = tmp_path / "actuators.py"
    with pytest.raises(InputError) as refused:
        Study(columns).export_simulator(target, "isaaclab")
    column = str(refused.value).partition(" add a column ")[2].split()[0]
    assert column == "torque_Nm"  # torque_1_Nm would belong to a position with that number
    made = Study({**columns, column: STIFF * (goal - q)}).export_simulator(target, "isaaclab")
    assert target.exists()
    assert any("viscous_friction" in line for line in made.used)
