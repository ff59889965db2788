"""`palpate export --format mjcf|urdf|isaaclab|bam`: fitted joints in other simulators, judged by MuJoCo."""

import json
import struct
import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from benchmarks import simulator_round_trip
from benchmarks.simulator_round_trip import CASES, NOISE_NM, URDF, round_trip
from palpate import Study
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import ParameterEstimate
from palpate.export.feedforward import TERMS
from palpate.export.target_terms import (
    TABLE,
    TILT_OF_ARM,
    SimulatorFormat,
    TargetArm,
    TargetJoint,
    TermValue,
    express,
)
from palpate.export.xml_model import Mounting, patch_mjcf, patch_urdf
from palpate.robot_io.calibration.applied import gravity_base_m_s2
from palpate.robot_io.errors import InputError
from tests.estimation.swings import swings
from tests.files import saved
from tests.palpate.cli import as_json, assert_refused, run
from tests.palpate.presses import write_table

pytestmark = pytest.mark.usefixtures("without_figures")
HAND_MADE = """<!-- hand made -->
<mujoco>
  <compiler angle="degree"/>
  <default>
    <joint damping="0.7"/>
    <default class="strong"><motor gear="3 0 0 0 0 0"/></default>
  </default>
  <worldbody>
    <body name="upper">
      <!-- mine -->
      <joint name="shoulder" axis="0 1 0"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="fore" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder" class="strong"/><position joint="elbow" kp="5"/></actuator>
</mujoco>
"""
LEVEL = Mounting("tip", np.array([0.25, 0.0, 0.02]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -9.81]))


def arm_of(arm=(), **values):
    """An arm whose only fitted joint is its elbow, with these values."""
    own = {key: TermValue(number, (f"{key} from -- a fit",)) for key, number in values.items()}
    whole = {key: TermValue(number, (key,)) for key, number in dict(arm).items()}
    return TargetArm("swing--1.csv", (TargetJoint("joint_2", "elbow", own, ()),), whole, ())


def patched(arm, text=HAND_MADE, **options):
    result = patch_mjcf(text, "mine.xml", arm, LEVEL, by_name=options.get("by_name", True))
    return mujoco.MjModel.from_xml_string(result.text), result


def effort(model, q=(0.0, 0.0), v=(0.0, 0.0), a=(0.0, 0.0)):
    """What MuJoCo's inverse dynamics takes at the elbow."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="elbow"', 'name="elbow" stiffness="1,5"', "<joint> 'elbow' stiffness '1,5'"),
        ('name="elbow"', 'name="elbow" stiffness="nan"', "<joint> 'elbow' stiffness 'nan'"),
        ('name="elbow"', 'name="elbow" armature=" "', "<joint> 'elbow' armature ' '"),
        ("<default>", '<option timestep="abc"/><default>', "<option> timestep 'abc'"),
        ("<default>", '<option timestep="0"/><default>', "<option> timestep 0 s: must be above 0"),
        ('<position joint="elbow" kp="5"/>', '<motor joint="elbow" gear="x"/>', "<motor> 'elbow' gear 'x'"),
        ('<position joint="elbow" kp="5"/>', '<motor joint="elbow" gear=""/>', "<motor> 'elbow' gear ''"),
    ],
)
def test_invalid_number_of_the_file_is_refused_with_its_place(old, new, said):
    arm = arm_of(frictionloss=0.1, gap=0.01, gear=1.2, sensor_delay_s=0.002)
    with pytest.raises(InputError, match=r"^mine\.xml: <") as refused:
        patch_mjcf(HAND_MADE.replace(old, new), "mine.xml", arm, LEVEL, by_name=True)
    assert said in str(refused.value)


@pytest.mark.parametrize("name", ["coulomb_and_viscous", "torque_gain"])
def test_exported_joint_predicts_an_unseen_motion_as_well_as_the_fit(name, tmp_path, monkeypatch):
    monkeypatch.setattr(simulator_round_trip, "SECONDS", 3.0)
    trip = round_trip(CASES[name], tmp_path, diagnose=False)
    assert trip.replayed < 1.05 * trip.promised < 1.2 * NOISE_NM < 0.2 * trip.nominal
    assert trip.motion < 0.01 * trip.nominal_motion  # under the same commands


def test_springs_dampers_rotor_and_dry_friction_follow_their_equations():
    spring = {"stiffness": 1.5, "preload": -0.6, "cubic": 2.0}
    plain = mujoco.MjModel.from_xml_string(HAND_MADE.replace('damping="0.7"', ""))
    model, _ = patched(arm_of(damping=0.3, damping_quadratic=0.08, armature=0.02, **spring))
    for q, v, a in ((0.7, 1.3, 4.0), (-0.4, -2.0, 1.0), (0.0, 0.5, -3.0)):
        extra = effort(model, (0.2, q), (0.0, v), (0.0, a)) - effort(plain, (0.2, q), (0.0, v), (0.0, a))
        expected = 1.5 * q - 0.6 + 2.0 * q**3 + 0.3 * v + 0.08 * v * abs(v) + 0.02 * a
        assert extra == pytest.approx(expected, abs=1e-6)
    model, _ = patched(arm_of(frictionloss=0.5, damping=0.0))
    plain = mujoco.MjModel.from_xml_string(HAND_MADE.replace('damping="0.7"', ""))
    for v, a in ((0.05, -8.0), (-0.05, 8.0), (1.0, 0.0)):
        extra = effort(model, v=(0.0, v), a=(0.0, a)) - effort(plain, v=(0.0, v), a=(0.0, a))
        assert extra == pytest.approx(0.5 * np.sign(v), abs=1e-3)


def test_payload_goes_to_the_tip_and_a_tilt_into_gravity():
    model, result = patched(arm_of({"payload_kg": 0.4, "tilt_rad": 0.1}))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    load = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "palpate_payload")
    assert model.body_mass[load] == 0.4
    assert data.xpos[load] == pytest.approx([0.55, 0.0, 0.02])
    assert model.opt.gravity == pytest.approx(9.81 * np.array([np.sin(0.1), 0.0, -np.cos(0.1)]))
    model, _ = patched(arm_of({"pitch_rad": 0.1, "roll_rad": -0.2}))
    assert model.opt.gravity == pytest.approx(gravity_base_m_s2(0.1, -0.2))
    site = '<site name="tip" pos="0.2 0 0"/></body></body>'
    model, _ = patched(arm_of({"payload_kg": 0.4}), HAND_MADE.replace("</body>\n    </body>", site))
    assert model.body_pos[-1] == pytest.approx([0.2, 0.0, 0.0])
    _, result = patched(arm_of({"payload_kg": -0.1}))
    assert any("is negative" in line for line in result.left_out)


def test_both_angles_of_a_tilt_are_those_of_the_most_certain_joint():
    def joint(number, pitch, half):
        angles = {"pitch": pitch, "roll": 0.2}
        tilt = {k: ParameterEstimate(k, "rad", v, half, (v - half, v + half)) for k, v in angles.items()}
        return SimpleNamespace(name=f"joint_{number}", number=number, by_effect={"gravity_tilt": tilt})

    joints = [joint(1, 0.11, 0.02), joint(2, 0.1, 0.001)]
    found = express(joints, TABLE[SimulatorFormat.MJCF], "swing.csv")
    assert {key: each.number for key, each in found.arm.items()} == {"pitch_rad": 0.1, "roll_rad": 0.2}
    assert sum("smallest interval" in line for line in found.left_out) == 1
    assert "inverse dynamics" in express(joints, TERMS, "swing.csv").left_out[0]


def test_only_parameters_in_the_file_are_said_to_be_exported():
    def joint(number, **effects):
        made = {
            effect: {k: ParameterEstimate(k, "u", v, 1.0, (v - 2.0, v + 2.0)) for k, v in values.items()}
            for effect, values in effects.items()
        }
        return SimpleNamespace(name=f"joint_{number}", number=number, by_effect=made)

    stribeck = {"coulomb": 0.5, "rise": 0.4, "speed": 0.3, "transition": 0.01}
    servo = joint(1, stribeck_friction=stribeck, delay={"time": -0.01})
    lines = express([servo], TABLE[SimulatorFormat.MJCF], "").left_out
    assert [line.split()[1] for line in lines if "is exported" in line] == ["stribeck_friction.coulomb"]
    (late,) = (line for line in lines if "'delay'" in line)
    assert "the motion lags the effort" in late
    assert "delay.time -0.01 u" in late
    pair = [joint(1, payload={"mass": 0.2}), joint(2, payload={"mass": 0.1})]
    arm = express(pair, TABLE[SimulatorFormat.MJCF], "")
    assert sum("is exported" in line for line in arm.left_out) == 1


@pytest.mark.parametrize("base", [6.3, 9.5])
def test_viscosity_is_the_same_in_all_formats_however_the_fit_splits_it(base):
    """Only the sum of the base model's viscosity and that of the two directions is known."""

    def estimates(**values):
        nothing = (float("nan"), float("nan"))
        return {k: ParameterEstimate(k, "", v, float("nan"), nothing) for k, v in values.items()}

    sides = {"forward": 6.0, "backward": 4.0, "viscous_forward": 8.1 - base, "viscous_backward": 7.9 - base}
    effects = {
        "viscous_friction": estimates(d=base),
        "asymmetric_friction": estimates(**sides, transition=0.1),
    }
    joint = SimpleNamespace(name="joint_1", number=1, by_effect=effects)
    for target, dry, viscous in (
        (SimulatorFormat.MJCF, "frictionloss", "damping"),
        (SimulatorFormat.URDF, "friction", "damping"),
        (SimulatorFormat.ISAACLAB, "dynamic_friction", "viscous_friction"),
        (SimulatorFormat.BAM, "friction_base", "friction_viscous"),
    ):
        values = express([joint], TABLE[target], "axis.csv").joints[0].values
        assert [values[key].number for key in (dry, viscous)] == pytest.approx([5.0, 8.0])
    made = express([joint], TERMS, "axis.csv")
    values = made.joints[0].values
    names = ("friction_level", "viscous", "friction_transition")
    assert [values[name].number for name in names] == pytest.approx((5.0, 8.0, 0.1))
    assert any("determine it only in combination with other parameters" in line for line in made.left_out)
    assert not any("includes zero" in line for line in made.left_out)


def test_gap_lets_the_link_move_freely_within_it():
    # motors that hold still, while gravity pulls the link through the gap
    heavy = HAND_MADE.replace('name="shoulder"', 'name="shoulder" armature="1e6"')
    model, result = patched(arm_of(gap=0.02, damping=0.0, armature=1e6), heavy)
    data = mujoco.MjData(model)
    assert model.nq == 3
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(0.01, rel=0.1)
    assert any("elbow_backlash" in line for line in result.used)
    assert not any("gap's ends" in line for line in result.left_out)
    _, result = patched(arm_of(gap=0.02))
    assert any("gap's ends" in line for line in result.left_out)
    frozen = HAND_MADE.replace("</mujoco>", '<keyframe><key qpos="0 0"/></keyframe></mujoco>')
    _, result = patched(arm_of(gap=0.02), frozen)
    assert any("keyframes" in line for line in result.left_out)


def test_torque_scale_goes_into_the_gear_and_a_delay_into_the_sensor():
    scaled = TargetArm("", (TargetJoint("joint_1", "", {"gear": TermValue(1.25, ())}, ()),), {}, ())
    model, result = patched(scaled, by_name=False)
    assert model.actuator_gear[0, 0] == pytest.approx(3.75)
    assert not result.left_out[1:]  # beside the damping that is kept
    model, result = patched(arm_of(gear=1.25))
    assert model.actuator_gear[1, 0] == 1.0
    assert any("<position>" in line for line in result.left_out)
    model, _ = patched(arm_of(sensor_delay_s=0.008, damping=0.0))
    data, read, true = mujoco.MjData(model), [], []
    for step in range(40):
        data.ctrl[1] = 1.0 if step >= 10 else 0.0
        mujoco.mj_step(model, data)
        read.append(data.sensordata[0])
        true.append(data.qfrc_actuator[1])
    assert int(np.argmax(np.array(read) > 0.5)) - int(np.argmax(np.array(true) > 0.5)) == 4  # of 2 ms


def test_contradicting_settings_of_the_file_are_kept_and_reported():
    _, result = patched(arm_of(armature=0.02))
    assert "damping 0.7 of the file is kept" in result.left_out[0]
    assert "hand made" in result.text
    assert "<!-- mine -->" in result.text
    assert "from - - a fit" in result.text
    assert "left out or doubtful: joint_2: damping 0.7" in result.text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HAND_MADE.replace("elbow", "wrist"), "needs a joint 'elbow', but the file has none"),
        (HAND_MADE.replace("shoulder", "elbow"), "2 joints are called 'elbow'"),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "document type"),
        ("<robot/>", "its root is <robot>"),
        ("<mujoco>", "not readable"),
    ],
)
def test_unpatchable_file_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        patch_mjcf(text, "mine.xml", arm_of(damping=1.0), LEVEL, by_name=True)


def test_urdf_gets_mujoco_settings_and_every_table_effect_is_in_the_library():
    result = patch_urdf(URDF, "arm.urdf", arm_of({"payload_kg": 0.4}, friction=0.3, damping=0.2), LEVEL)
    before, after = (mujoco.MjModel.from_xml_string(text) for text in (URDF, result.text))
    assert (after.dof_damping[1], after.dof_frictionloss[1]) == (0.2, 0.3)
    assert np.sum(after.body_mass) - np.sum(before.body_mass) == pytest.approx(0.4)
    assert {effect for terms in (*TABLE.values(), TERMS) for effect in terms} <= {*EFFECTS, TILT_OF_ARM}
    assert set(TABLE) == set(SimulatorFormat)


def test_a_motion_that_is_late_is_no_delay_of_a_sensor():
    delay = TABLE[SimulatorFormat.MJCF]["delay"]
    assert not isinstance(delay, str)
    assert delay.values({"time": 0.008}) == {"sensor_delay_s": 0.008}
    assert delay.values({"time": -0.008}) == {}


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A joint with Stribeck and viscous friction and a delay, recorded, and its study."""
    folder = tmp_path_factory.mktemp("swinging")
    rng, t = np.random.default_rng(3), np.arange(0.0, 6.0, 0.006)
    columns = {name: [] for name in ("run", "time_s", "position_rad", "velocity_rad_s", "torque_Nm")}
    for number, rate in enumerate((1.1, 1.7, 2.6, 3.5)):
        v = 0.8 * rate * np.cos(rate * t)
        a = -0.8 * rate**2 * np.sin(rate * t)
        friction = (0.4 + 0.3 * np.exp(-((v / 0.3) ** 2))) * np.sign(v) + 0.1 * v
        torque = 0.05 * a + friction + rng.normal(0.0, 0.01, len(t))
        rows = (np.full(len(t), number), t, 0.8 * np.sin(rate * t), v, torque)
        for name, values in zip(columns, rows, strict=True):
            columns[name].extend(values)
    data = write_table(folder / "swing.csv", **columns)
    Study(data, "inertia", folder=folder / "study").add("stribeck_friction")
    return data, folder


def exported(swinging, form, *options):
    data, folder = swinging
    out = folder / {"isaaclab": "out.py", "bam": "out.json"}.get(form, f"out.{form}")
    said = as_json(
        "export", data, "--folder", folder / "study", "--format", form, "-o", out, "--force", *options
    )
    return out.read_text(), said


def test_isaac_lab_gets_static_and_dynamic_friction(swinging, monkeypatch):
    text, said = exported(swinging, "isaaclab")
    package, module = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    module.ImplicitActuatorCfg = SimpleNamespace
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", module)
    content = {}
    exec(compile(text, "actuators.py", "exec"), content)
    joint = content["ACTUATORS"]["joint_1"]
    assert joint.joint_names_expr == ["joint_1"]
    assert joint.friction == pytest.approx(0.7, rel=0.05)
    assert joint.dynamic_friction == pytest.approx(0.4, rel=0.05)
    assert joint.viscous_friction == pytest.approx(0.1, rel=0.1)
    assert "95 %" in text
    assert any("'inertia' includes everything the joint carries" in line for line in said["left_out"])
    assert any("Stribeck speed" in line for line in said["left_out"])


def test_bam_gets_its_stribeck_model_and_keeps_the_motor(swinging, tmp_path):
    motor = tmp_path / "motor.json"
    known = {"actuator": "sts3215", "kt": 1.3, "R": 2.7, "armature": 0.02}
    motor.write_text(json.dumps(known | {"model": "m6", "load_friction_motor_quad": 0.01}))
    text, _ = exported(swinging, "bam", "--patch", motor)
    content = json.loads(text)
    assert "load_friction_motor_quad" not in content  # M2 has no such friction
    assert content.items() >= (known | {"model": "m2", "alpha": 2.0}).items()
    assert content["friction_base"] == pytest.approx(0.4, rel=0.05)
    assert content["friction_stribeck"] == pytest.approx(0.3, rel=0.1)
    assert content["dtheta_stribeck"] == pytest.approx(0.3, rel=0.1)
    assert content["friction_viscous"] == pytest.approx(0.1, rel=0.1)
    _, said = exported(swinging, "bam")
    assert any('"kt"' in line for line in said["left_out"])


def test_every_file_states_how_the_data_were_read(tmp_path):
    study = Study(swings(4), "inertia")
    study.source = replace(study.source, read="torque 'x'", notes=("the sign\nis reversed; --unit keeps it",))
    study.add("coulomb_friction")
    study.export(tmp_path / "scenario.yaml")
    study.export_feedforward(tmp_path / "table.yaml")
    mjcf = saved(tmp_path / "mine.xml", HAND_MADE)
    urdf = saved(tmp_path / "mine.urdf", '<robot name="r"><joint name="joint_1"/></robot>')
    for target, base in (("mjcf", mjcf), ("urdf", urdf), ("isaaclab", None), ("bam", None)):
        study.export_simulator(tmp_path / target, target, base)
    for file in {*tmp_path.iterdir()} - {mjcf, urdf}:
        text = " ".join(file.read_text().replace("\\n", " ").split())
        assert "torque 'x'" in text.replace("''", "'"), file
        assert "the sign is reversed" in text, file
        assert ("--unit" in text) is (file.name not in {"mjcf", "urdf"}), file  # ends no comment of XML


def test_mjcf_without_urdf_takes_joints_in_their_order(swinging, tmp_path):
    mine = saved(tmp_path / "mine.xml", HAND_MADE)
    text, said = exported(swinging, "mjcf", "--patch", mine)
    joint = ElementTree.fromstring(text).find(".//joint[@name='shoulder']")
    assert float(joint.get("frictionloss")) == pytest.approx(0.4, rel=0.05)
    assert float(joint.get("damping")) == pytest.approx(0.1, rel=0.1)
    assert mine.read_text() == HAND_MADE
    assert any("rise at low speed" in line for line in said["left_out"])


MESH = b"\0" * 80 + struct.pack("<I", 4)
for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
    corners = np.vstack([np.zeros(3), 0.1 * np.eye(3)])[list(face)]
    MESH += struct.pack("<12f2x", 0.0, 0.0, 0.0, *corners.ravel())


@pytest.mark.parametrize("compiler", ["", '<compiler meshdir="parts"/>', '<compiler assetdir="parts"/>'])
def test_copy_in_another_folder_finds_the_original_meshes(swinging, tmp_path, compiler):
    mine, out = tmp_path / "mine", tmp_path / "deep" / "er"
    (mine / "parts").mkdir(parents=True)
    out.mkdir(parents=True)
    (mine / "parts" / "link.stl").write_bytes(MESH)
    name = "link.stl" if compiler else "parts/link.stl"
    (mine / "arm.xml").write_text(f"""<mujoco>{compiler}
        <asset><mesh name="link" file="{name}"/></asset>
        <worldbody><body><joint/><geom type="mesh" mesh="link"/></body></worldbody></mujoco>""")
    data, folder = swinging
    base = ("export", data, "--folder", folder / "study", "--format", "mjcf")
    as_json(*base, "--patch", mine / "arm.xml", "-o", out / "better.xml")
    model = mujoco.MjModel.from_xml_path(str(out / "better.xml"))
    assert (model.nmesh, model.dof_frictionloss[0]) == (1, pytest.approx(0.4, rel=0.05))


@pytest.mark.parametrize(
    ("compiler", "written", "meshdir"),
    [
        ("", "../../mine/parts/link.stl", None),
        ('<mujoco><compiler meshdir="parts"/></mujoco>', "../../mine/parts/link.stl", "../../mine/parts"),
        ('<mujoco><compiler meshdir="a" strippath="false"/></mujoco>', "parts/link.stl", "../../mine/a"),
    ],
)
def test_urdf_in_another_folder_names_the_original_meshes(compiler, written, meshdir):
    names = ("parts/link.stl", "package://mine/link.stl", "/abs/link.stl")
    shapes = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in names)
    text = URDF.replace("</link>", f"{shapes}</link>", 1).replace("</robot>", f"{compiler}</robot>")
    copy = patch_urdf(text, "arm.urdf", arm_of(friction=0.1), LEVEL, folder="../../mine").text
    root = ElementTree.fromstring(copy)
    assert [each.get("filename") for each in root.iter("mesh")] == [written, *names[1:]]
    assert [each.get("meshdir") for each in root.iter("compiler")] == ([meshdir] if meshdir else [])


def test_included_files_are_patched(swinging, tmp_path):
    (tmp_path / "arm.xml").write_text(HAND_MADE)
    scene = tmp_path / "scene.xml"
    scene.write_text('<mujoco><include file="arm.xml"/></mujoco>')
    data, folder = swinging
    base = ("export", data, "--folder", folder / "study", "--format", "mjcf", "--patch", scene, "-o")
    assert_refused(run(*base, tmp_path / "better.xml"), "in the included file arm.xml, patch that file")
    assert_refused(run(*base, tmp_path / "new" / "better.xml"), "included file arm.xml beside", "with -o")


SERVO = """<mujoco><worldbody><body><joint name="lift" axis="0 0 1"{}/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position joint="lift" kp="30"/></actuator></mujoco>"""


def follow(text, seed):
    """Goals of a servo and the positions that it reaches, every 2 ms."""
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    phase, rate = rng.uniform(0, 6, 3), rng.uniform([0.8, 2.0, 4.0], [1.6, 3.5, 6.0])
    goal = np.sin(rate * 0.002 * np.arange(4000)[:, None] + phase) @ [0.5, 0.25, 0.1]
    position = np.empty(len(goal))
    for i, data.ctrl[0] in enumerate(goal):
        position[i] = data.qpos[0]
        mujoco.mj_step(model, data)
    return goal, position


def test_servo_without_torques_is_exported_with_its_gain_and_moves_as_recorded(tmp_path):
    hidden = SERVO.format(' damping="0.6" frictionloss="0.8" solreffriction="0.004 1"')
    nominal = SERVO.format("")
    runs = [np.stack(follow(hidden, seed))[:, 500::5] for seed in range(3)]
    goal, q = np.concatenate(runs, axis=1)
    q += np.random.default_rng(1).normal(0.0, 2e-4, len(q))
    t, run_number = np.tile(0.01 * np.arange(700), 3), np.repeat(np.arange(3), 700)
    columns = {"run": run_number, "time_s": t, "goal_position_rad": goal, "position_rad": q}
    data = write_table(tmp_path / "servo.csv", **columns)
    mine, out = tmp_path / "servo.xml", tmp_path / "o.xml"
    mine.write_text(nominal)
    run("add", data, "coulomb_friction", "--out", tmp_path / "study")
    base = ("export", data, "--folder", tmp_path / "study", "--format", "mjcf", "--patch", mine, "-o", out)
    for options, said in ((), "with --servo-gain"), (("--servo-gain", -1), "must be above 0"):
        refused = run(*base, *options)
        assert (refused.exit_code, said in refused.stderr) == (2, True)
    made = as_json(*base, "--servo-gain", 30)
    (damping, friction), exported_text = made["used"], out.read_text()
    assert "N m s/rad" in damping
    assert float(damping.split()[3]) == pytest.approx(0.6, rel=0.03)
    assert float(friction.split()[3]) == pytest.approx(0.8, rel=0.03)
    assert not any("kp" in line or "kv" in line for line in made["left_out"])
    mine.write_text(nominal.replace('kp="30"', 'kp="30" kv="2"'))
    other = as_json(*base, "--servo-gain", 40, "--force")["left_out"]
    assert any("kp 30 of <position> is kept, but the servo's gain is 40" in line for line in other)
    assert any("kv 2 of <position>" in line for line in other)
    true = follow(hidden, 9)[1]
    before, after = (np.std(follow(text, 9)[1] - true) for text in (nominal, exported_text))
    assert after < 4e-4 < 0.01 * before  # of the order of the noise


def test_servo_gain_is_refused_with_measured_torque(swinging, tmp_path):
    data, folder = swinging
    base = ("export", data, "--folder", folder / "study", "-o", tmp_path / "x.py", "--servo-gain", 2)
    assert_refused(run(*base, "--format", "isaaclab"), "the effort of joint_1 was measured")
    assert_refused(run(*base, "--format", "feedforward"), "only for --format mjcf")


def test_joint_without_a_revision_gets_its_base_model_with_a_warning(swinging, tmp_path):
    data, folder = swinging
    base = ("export", data, "--format", "feedforward", "-o", tmp_path / "out.yaml", "--force")
    (tmp_path / "empty").mkdir()
    plain = run(*base, "--folder", tmp_path / "empty")
    assert "no effect was added to joint_1, so the base model is exported" in " ".join(plain.stderr.split())
    assert "no effect was added" not in run(*base, "--folder", folder / "study").stderr


@pytest.mark.parametrize(
    ("ripple_n_m", "finding"),
    [(0.0, "the diagnosis finds joint_1 adequate"), (0.1, "the diagnosis of joint_1 names no effect to add")],
)
def test_diagnosed_joint_is_exported_without_advice_to_diagnose(few_effects, ripple_n_m, finding, tmp_path):
    rng, t = np.random.default_rng(4), np.tile(np.arange(0.0, 4.0, 0.02), 4)
    run_number = np.repeat(np.arange(4), 200)
    rate = np.array([1.1, 1.7, 2.6, 3.5])[run_number]
    columns = {
        "position_rad": 0.8 * np.sin(rate * t),
        "velocity_rad_s": 0.8 * rate * np.cos(rate * t),
        "acceleration_rad_s2": -0.8 * rate**2 * np.sin(rate * t),
    }
    torque = 0.05 * columns["acceleration_rad_s2"] + rng.normal(0.0, 0.01, len(t))
    torque += ripple_n_m * np.sin(9.0 * columns["position_rad"])
    data = write_table(tmp_path / "free.csv", run=run_number, time_s=t, torque_Nm=torque, **columns)
    run("diagnose", data, "--model", "inertia", "--out", tmp_path / "study")
    said = run("export", data, "--format", "bam", "--folder", tmp_path / "study", "-o", tmp_path / "b.json")
    assert f"{finding}, so the base model is exported" in said.stderr
    assert "--apply" not in said.stderr


def test_invalid_export_is_refused_in_one_line(swinging, tmp_path):
    data, folder = swinging
    mine = saved(tmp_path / "mine.xml", HAND_MADE)
    base = ("export", data, "--folder", folder / "study")
    assert_refused(run(*base, "--format", "mjcf", "-o", tmp_path / "x.xml"), "--patch FILE")
    out = run(*base, "--format", "mjcf", "--patch", mine, "-o", mine, "--force")
    assert_refused(out, "is the input")
    out = run(*base, "--format", "mjcf", "--patch", tmp_path, "-o", tmp_path / "x.xml")
    assert_refused(out, "is a directory, not a file")
    assert "such as" not in out.stderr  # the first file here is no MJCF
    assert mine.read_text() == HAND_MADE
    assert_refused(run(*base, "--patch", mine), "does not use this option. Valid formats: mjcf, urdf, bam")
    bad = saved(tmp_path / "bad.json", "[]")
    assert_refused(run(*base, "--format", "bam", "--patch", bad, "-o", tmp_path / "b.json"), "bad.json")
    bad.write_bytes(b"\xff\xfe\x00")
    out = run(*base, "--format", "mjcf", "--patch", bad, "-o", tmp_path / "x.xml")
    assert_refused(out, "--patch", "bad.json: cannot be read (not UTF-8 text")
