"""`palpate export --format feedforward`: identified joint effects improve tracking."""

import ctypes
import runpy
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from palpate.estimation.effects.path_memory import PreslidingFriction
from palpate.export.target_terms import as_comment
from palpate.robot_io.errors import InputError
from palpate.sim_backend.world import ArmDescription, World
from palpate.study import Study
from tests.estimation.swings import DAMPING, INERTIA, WEIGHT
from tests.estimation.swings import coarse_swings as swings
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import write_presses, write_table
from tests.sim_backend.hidden_parts import hidden, quiet_scenario

pytestmark = pytest.mark.usefixtures("without_figures")
TICK_S = 2e-3
MASS_KG, LENGTH_M, BODY_KGM2 = 0.8, 0.25, 0.004
PENDULUM = f"""
<robot name="pendulum">
  <link name="stand"/>
  <link name="rod"><inertial><origin xyz="0 0 -{LENGTH_M}"/><mass value="{MASS_KG}"/>
    <inertia ixx="{BODY_KGM2}" iyy="{BODY_KGM2}" izz="{BODY_KGM2}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="swing" type="revolute">
    <parent link="stand"/><child link="rod"/><origin xyz="0 0 2"/><axis xyz="0 -1 0"/>
    <limit lower="-6" upper="6" effort="100" velocity="100"/>
  </joint>
  <link name="probe"/>
  <joint name="mount" type="fixed"><parent link="rod"/><child link="probe"/></joint>
</robot>
"""
FRICTION = {"stiction_nm": 0.5, "speed_rad_s": 0.3, "coulomb_nm": 0.4}
VISCOUS = 0.12


def motion(t, seed):
    """Desired position, velocity and acceleration of three sines, shape (n,) each."""
    rng = np.random.default_rng(seed)
    size, phase = np.array([0.6, 0.35, 0.12]), rng.uniform(0.0, 6.0, 3)
    rate = rng.uniform([1.5, 3.0, 6.0], [2.5, 4.5, 8.0])
    waves = rate * t[:, None] + phase
    motion = (size * np.sin(waves), size * rate * np.cos(waves), -size * rate**2 * np.sin(waves))
    return tuple(signal.sum(1) for signal in motion)


def follow(seed, effort=lambda q, v, a: 0.0):
    """Follow a motion with feedback and this feedforward; columns t, q, v, torque, desired q."""
    arm = ArmDescription(PENDULUM, "probe", (0.0, 0.0, -1.0), (0.0,))
    friction = hidden("stribeck_friction", joint=1, **FRICTION)
    grease = hidden("viscous_friction", joint=1, viscous_nms_rad=VISCOUS)
    world = World(arm, quiet_scenario(friction, grease, surface_m=-9.0, rate_hz=2000.0))
    t = np.arange(0.0, 2.5, TICK_S)
    desired = np.column_stack(motion(t, seed))
    world.place(desired[0, :1], desired[0, 1:2])
    rows = []
    for time_s, (q, v, a) in zip(t, desired, strict=True):
        now = world.truth()
        position, velocity = now.joint_position_rad[0], now.joint_velocity_rad_s[0]
        torque = 60.0 * (q - position) + 2.0 * (v - velocity) + effort(q, v, a)
        rows.append((time_s, position, velocity, torque, q))
        world.set_torque([torque])
        world.advance_to(time_s + TICK_S)
    world.close()
    return np.array(rows)


def test_identified_feedforward_improves_tracking(tmp_path):
    """Recorded with feedback alone, as the other motion that then is followed with and without it."""
    rng = np.random.default_rng(5)
    recorded = [follow(seed) for seed in range(3)]
    t, q, v, torque, _ = np.concatenate(recorded).T
    run_number = np.repeat(np.arange(3), len(recorded[0]))
    torque = torque + rng.normal(0.0, 0.01, len(t))
    table = {"time_s": t, "position_rad": q, "velocity_rad_s": v, "torque_Nm": torque, "run": run_number}
    study = Study(table, "pendulum")
    study.add("stribeck_friction")
    study.export_feedforward(tmp_path / "swing.yaml")
    joint = yaml.safe_load((tmp_path / "swing.yaml").read_text())["joints"]["joint_1"]
    assert joint["gravity"]["sine"] == pytest.approx(MASS_KG * 9.81 * LENGTH_M, rel=0.05)
    assert joint["inertia"] == pytest.approx(MASS_KG * LENGTH_M**2 + BODY_KGM2, rel=0.05)
    assert joint["viscous"] == pytest.approx(VISCOUS, rel=0.1)
    assert joint["friction"]["level"] == pytest.approx(FRICTION["coulomb_nm"], rel=0.1)
    feedforward = runpy.run_path(str(tmp_path / "swing.py"))["feedforward"]
    plain, fed = follow(11), follow(11, lambda *state: feedforward(1, *state))
    errors = [float(np.sqrt(np.mean((rows[:, 1] - rows[:, 4]) ** 2))) for rows in (plain, fed)]
    assert errors[1] < 0.1 * errors[0], errors


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A data file of a pendulum with Stribeck friction, the folder of its feedforward, what `add` said."""
    folder = tmp_path_factory.mktemp("swinging")
    data = swings(3, lambda q, v, a: (0.3 + 0.5 * np.exp(-((v / 0.25) ** 2))) * np.tanh(v / 0.01))
    columns = {"time_s": data.time_s, "run": data.run, "position_rad": data.position}
    columns |= {"velocity_rad_s": data.velocity, "acceleration_rad_s2": data.acceleration}
    path = write_table(folder / "swing.csv", **columns, torque_Nm=data.effort)
    added = done("add", path, "stribeck_friction", "bias", "--model", "pendulum", "--out", folder)
    done("export", path, "--format", "feedforward", "--folder", folder, "-o", folder / "ff.yaml")
    return path, folder, added


def test_joint_effects_are_exported_to_simulator_and_feedforward(swinging):
    _, folder, added = swinging
    mjcf, feedforward = (words for words in next_commands(added) if "--format" in words)
    (folder / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
    )
    done(*[folder / "arm.xml" if word == "MODEL.xml" else word for word in mjcf])
    assert "frictionloss" in (folder / "model.xml").read_text()
    done(*feedforward)
    assert "joint_1" in (folder / "feedforward.yaml").read_text()


def function_of(folder):
    return runpy.run_path(str(folder / "ff.py"))["feedforward"]


def c_function_of(folder):
    library = folder / "ff.so"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-ffp-contract=off"]
    subprocess.run(["cc", *strict, "-shared", "-fPIC", folder / "ff.c", "-o", library, "-lm"], check=True)
    compiled = ctypes.CDLL(str(library)).feedforward
    compiled.restype, compiled.argtypes = ctypes.c_double, [ctypes.c_int, *[ctypes.c_double] * 3]
    return compiled


def states(count):
    rng = np.random.default_rng(2)
    return rng.uniform([-3.0, -3.0, -30.0], [3.0, 3.0, 30.0], (count, 3)).tolist()


def test_function_is_the_joint_s_own_law_without_the_sensor_zero(swinging):
    _, folder, _ = swinging
    feedforward = function_of(folder)
    for q, v, a in states(50):
        friction = (0.3 + 0.5 * np.exp(-((v / 0.25) ** 2))) * np.tanh(v / 0.01)
        expected = WEIGHT * np.sin(q) + INERTIA * a + DAMPING * v + friction
        assert feedforward(1, q, v, a) == pytest.approx(expected, abs=0.02)
    assert feedforward(1, 0.0, 0.0, 0.0) == 0.0
    with pytest.raises(KeyError):
        feedforward(2, 0.0, 0.0, 0.0)
    (left_out,) = yaml.safe_load((folder / "ff.yaml").read_text())["left_out"]
    assert left_out.startswith("joint_1: 'bias' may be a constant effort or the sensor's zero")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_function_matches_the_python_function(swinging):
    _, folder, _ = swinging
    compiled = c_function_of(folder)
    feedforward = function_of(folder)
    extreme = [[0.0, 1e200, 0.0], [1e6, -1e-300, 1.0]]
    for state in [*states(500), *extreme]:
        assert compiled(1, *state) == pytest.approx(feedforward(1, *state), rel=1e-14, abs=1e-15)
    assert np.isnan(compiled(2, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["a*/b", "a*\\b", 'a"""b', "a/*b", "a\nb"])
def test_file_name_ends_no_comment(name):
    assert not any(end in as_comment(name) for end in ("*/", '"""', "/*", "/n"))


def test_effects_without_a_term_are_reported(swinging, tmp_path):
    path, _, _ = swinging
    Study(path, "pendulum", folder=tmp_path).add("coulomb_friction", "joint_elasticity", "lag")
    found = as_json("export", path, "--format", "feedforward", "--folder", tmp_path)
    used = [line.split(" ")[1].partition(".")[0] for line in found["used"]]
    assert used == ["pendulum", "viscous_friction", "coulomb_friction"]
    elastic, lag = (
        next(line for line in found["left_out"] if name in line) for name in ("joint_elasticity", "lag")
    )
    assert "has no term in the file" in elastic
    assert "is an error of the reading" in lag
    for name in ("table", "python", "c"):
        assert found[name].startswith(str(tmp_path / "feedforward"))


def spring_and_drag(q, v, a):
    return 3.0 * (q - 0.2) + 0.05 * v * np.abs(v)


def friction_by_load(q, v, a):
    return 0.15 * np.abs(WEIGHT * np.sin(q) + 0.5 * INERTIA * a) * np.tanh(v / 0.02)


def friction_by_place(q, v, a):
    return (0.3 + 0.1 * np.sin(3.0 * q) - 0.08 * np.cos(3.0 * q)) * np.tanh(v / 0.02)


@pytest.mark.parametrize(
    ("law", "effects"),
    [
        (spring_and_drag, ("joint_spring", "quadratic_friction")),
        (friction_by_load, ("load_dependent_friction",)),
        (friction_by_place, ("position_dependent_friction",)),
    ],
)
def test_law_of_position_velocity_and_load_is_in_all_three_files(law, effects, tmp_path):
    study = Study(swings(4, law, runs=6), "pendulum")
    study.add(*effects)
    used = study.export_feedforward(tmp_path / "ff.yaml").used
    assert not any(" 1 (95 %" in line for line in used)  # a number without unit
    feedforward = function_of(tmp_path)
    compiled = c_function_of(tmp_path) if shutil.which("cc") else feedforward
    rng = np.random.default_rng(2)
    table = yaml.safe_load((tmp_path / "ff.yaml").read_text())
    values = dict(vars(np), fabs=np.abs)
    for section, _, own in (name.partition(".") for name in table["units"]):
        assert own in table["joints"]["joint_1"][section] if own else section in table["joints"]["joint_1"]
    for name, value in table["joints"]["joint_1"].items():
        values[name] = SimpleNamespace(**value) if isinstance(value, dict) else value
    errors = []
    for q, v, a in rng.uniform([-1.2, -3.0, -20.0], [1.2, 3.0, 20.0], (200, 3)).tolist():
        expected = WEIGHT * np.sin(q) + INERTIA * a + DAMPING * v + law(q, v, a)
        errors.append(feedforward(1, q, v, a) - expected)
        state = {"q": q, "v": v, "a": a}
        for line in table["equations"]:
            name, _, formula = line.partition(" = ")
            state[name] = eval(formula, values, state)
        assert state["effort"] == pytest.approx(feedforward(1, q, v, a), rel=1e-12, abs=1e-12)
        assert compiled(1, q, v, a) == pytest.approx(feedforward(1, q, v, a), rel=1e-12, abs=1e-12)
    assert np.sqrt(np.mean(np.square(errors))) < 0.03


def test_friction_of_a_recorded_load_is_left_out(tmp_path):
    data = swings(4, friction_by_load)
    load = {"load": WEIGHT * np.sin(data.position) + INERTIA * data.acceleration}
    study = Study(replace(data, context=load, recorded=frozenset(load)), "pendulum")
    study.add("load_dependent_friction")
    made = study.export_feedforward(tmp_path / "ff.yaml")
    assert any("'load_dependent_friction' needs the load" in line for line in made.left_out)
    drag = function_of(tmp_path)
    assert (drag(1, 0.5, 1.0, 0.0) - drag(1, 0.5, -1.0, 0.0)) / 2.0 == pytest.approx(DAMPING, abs=0.05)


def test_presliding_friction_has_its_level_away_from_reversals(tmp_path):
    data = swings(4)
    built = PreslidingFriction().columns(data, {"presliding": 0.05})[:, 0]
    study = Study(replace(data, effort=data.effort + 0.4 * built), "pendulum")
    study.add("presliding_friction")
    made = study.export_feedforward(tmp_path / "ff.yaml")
    drag = function_of(tmp_path)
    friction = (drag(1, 0.0, 1.0, 0.0) - drag(1, 0.0, -1.0, 0.0)) / 2.0
    assert friction == pytest.approx(0.4 + DAMPING, abs=0.02)
    assert any("the path over which it builds up is left out" in line for line in made.left_out)


def test_undetermined_transition_makes_no_jump_at_speeds_below_the_data(tmp_path):
    """At 1e-5 rad/s, which no sample comes near, the friction must not be there in full."""
    study = Study(swings(4, lambda q, v, a: 0.3 * np.sign(v), rate_hz=200.0), "pendulum")
    study.add("coulomb_friction")
    assert (
        study.fit("joint_1", ["coulomb_friction"]).parameters["coulomb_friction.transition"].determined
        == "no"
    )
    made = study.export_feedforward(tmp_path / "ff.yaml")
    drag = function_of(tmp_path)
    assert abs(drag(1, 0.0, 1e-5, 0.0)) < 0.01
    assert drag(1, 0.0, 0.2, 0.0) == pytest.approx(0.3 + 0.2 * DAMPING, abs=0.02)
    assert any("coulomb_friction.transition" in line and "not determined" in line for line in made.left_out)


def test_friction_that_depends_on_the_direction_becomes_that_of_both(tmp_path):
    data = swings(4, lambda q, v, a: np.where(v > 0.0, 0.6, 0.3) * np.tanh(v / 0.01))
    study = Study(data, "pendulum")
    study.add("asymmetric_friction")
    made = study.export_feedforward(tmp_path / "ff.yaml")
    drag = function_of(tmp_path)
    friction = [(drag(1, 0.0, v, 0.0) - drag(1, 0.0, -v, 0.0)) / 2.0 for v in (0.05, 1.0, 2.0)]
    assert friction == pytest.approx([0.45 + v * DAMPING for v in (0.05, 1.0, 2.0)], abs=0.02)
    assert any("mean" in line for line in made.left_out)


def test_without_revisions_the_base_model_is_written(swinging, tmp_path):
    study = Study(swings(4), "inertia")
    study.export_feedforward(tmp_path / "plain.yaml")
    (joint,) = yaml.safe_load((tmp_path / "plain.yaml").read_text())["joints"].values()
    assert joint["model"] == "inertia"
    assert joint["inertia"] == study.fit("joint_1").values["inertia.m"]


def test_revisions_of_other_data_or_base_model_are_reported(tmp_path):
    Study(swings(4), "inertia", folder=tmp_path).add("coulomb_friction")
    other_data = Study(swings(5), "inertia", folder=tmp_path)
    other_model = Study(swings(4), "pendulum", folder=tmp_path)
    for other, words in (
        (other_data, "revision 1 is from other data"),
        (
            other_model,
            "no revision of joint_1 with base model pendulum, only with inertia; .* add revision=1",
        ),
    ):
        with pytest.raises(InputError, match=words):
            other.export_feedforward(tmp_path / "other.yaml")
    assert not (tmp_path / "other.yaml").exists()
    other_model.export_feedforward(tmp_path / "chosen.yaml", 1)
    (joint,) = yaml.safe_load((tmp_path / "chosen.yaml").read_text())["joints"].values()
    assert joint["model"] == "inertia + coulomb_friction"


def test_revisions_of_other_channels_are_not_ignored(tmp_path):
    Study(swings(4), "inertia", folder=tmp_path).add("coulomb_friction")
    contact = Study(write_presses(tmp_path / "press.csv"), folder=tmp_path)
    with pytest.raises(InputError, match=r"only revisions of other channels \(joint_1\)"):
        contact.export(tmp_path / "world.yaml")
    assert not (tmp_path / "world.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--stream", "joint_1"), "--stream and --format feedforward: only one file is written"),
        (("-o", "ff.csv"), "the name of a feedforward table must end in .yaml"),
        (("--revision", 9), "no revision 9"),
    ],
)
def test_effects_without_feedforward_are_refused(swinging, arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path, folder, _ = swinging
    assert_refused(run("export", path, "--format", "feedforward", "--folder", folder, *arguments), words)
    assert not list(tmp_path.iterdir())


def test_contact_has_no_feedforward(hardening, tmp_path):
    result = run("export", hardening, "--format", "feedforward", "-o", tmp_path / "ff.yaml")
    assert_refused(result, "no channel is a joint", "Channels: contact")
