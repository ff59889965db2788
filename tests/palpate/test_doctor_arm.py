"""`palpate doctor` on an arm: wiring faults are named, and nothing stays powered."""

import itertools
import json
import re
import signal
from functools import partial

import numpy as np
import pytest

from palpate.common.console import AT_REST, FIRST_PROBE
from palpate.control.arm.rigid_body import RigidBody
from palpate.doctor import arm as arm_check
from palpate.doctor import signs
from palpate.doctor.arm import ArmCheck, examine_arm
from palpate.doctor.limits import examine_limits
from palpate.doctor.signs import NUDGE_RAD, ArmOperator, EmulatedOperator, NudgeTask
from palpate.robot_io.calibration.applied import Calibrations
from palpate.robot_io.errors import SafetyTripError
from palpate.robot_io.examination import Level
from palpate.robot_io.robot_file import load_robot_file, parse_robot_file
from palpate.robot_io.types import Measurement, Status
from tests.mock_robot import MockForce, build_mock_robot, mock_robot_file
from tests.palpate.cli import ROOT, assert_refused, done, run
from tests.robot_io.calibration.parts import calibration_of

pytestmark = pytest.mark.slow

ROBOTS = ROOT / "robots"
DYNAMIXEL, ODRIVE, CUBEMARS, ROBSTRIDE = (
    ROBOTS / f"{name}_3dof.yaml" for name in ("dynamixel", "odrive", "cubemars", "robstride")
)
UNCHECKED = ["torque of joint 3", "zeros", "scale of the force", "lengths of the links"]


def changed(path, *changes):
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_robot_file(text, path)


def examined(path, as_built=None, **options):
    check = ArmCheck(load_robot_file(path), wired=True, as_built=as_built, **options)
    return list(examine_arm(check))


def failures(findings):
    return [finding for finding in findings if finding.level is Level.FAIL]


@pytest.fixture(autouse=True)
def one_second_until_power(monkeypatch):
    monkeypatch.setattr(signs, "_COUNT_S", 1)


@pytest.fixture
def plants(monkeypatch):
    """What stood behind the emulated devices, kept to look at the torque afterwards."""
    seen, emulate = [], arm_check.emulate

    def watched(*arguments, **options):
        arm = emulate(*arguments, **options)
        close = arm.emulator.close

        def note_and_close():
            seen.append(arm.plant.world.truth().drive_torque_nm.copy())
            close()

        arm.emulator.close = note_and_close
        return arm

    monkeypatch.setattr(arm_check, "emulate", watched)
    return seen


@pytest.mark.parametrize("path", [DYNAMIXEL, ODRIVE, CUBEMARS], ids=lambda path: path.stem)
def test_valid_arm_passes_all_checks_and_ends_without_torque(path, plants):
    findings = examined(path, move=True, may_power=lambda: True)
    assert not failures(findings)
    subjects = {finding.subject for finding in findings}
    assert {"sign of joint 3", "sign of the force", "drive of joint 3", "rate of motors"} <= subjects
    assert [finding.subject for finding in findings if finding.level is Level.SKIP] == UNCHECKED
    warned = {finding.subject for finding in findings if finding.level is Level.WARN}
    assert warned <= ({"rate of motors"} if path is ODRIVE else set())
    assert np.abs(plants).max() < 0.02


def test_nothing_is_powered_without_confirmation(plants):
    findings = examined(DYNAMIXEL, move=True, may_power=lambda: False)
    assert [finding.subject for finding in findings[-2:]] == ["hands away", "drives"]
    assert findings[-1].level is Level.WARN
    assert "not examined" in findings[-1].text
    assert not np.any(plants)


@pytest.mark.parametrize(
    ("path", "built", "subject", "words"),
    [
        (DYNAMIXEL, ("id: 2, model", "id: 7, model"), "servo 2 (joint 2)", "id 7"),
        (DYNAMIXEL, ("id: 3, model: XM430-W350", "id: 3, model: XH540-W270"), "servo 3 (joint 3)", "XH540"),
        (DYNAMIXEL, ("id: 1, model", "id: 1, firmware: 30, model"), "servo 1 (joint 1)", "firmware 30"),
        (DYNAMIXEL, ("4000000", "1000000"), "servos", "at 1000000 bit/s"),
        (DYNAMIXEL, ("230400", "9600"), "force sensor", "baud rate"),
        (DYNAMIXEL, ("capacity_n: 100.0", "capacity_n: 50.0"), "force sensor", "50 N"),
        (ODRIVE, ("node_id: 1", "node_id: 9"), "joint 2 (node 1)", "no heartbeat"),
        (CUBEMARS, ("motor_id: 3", "motor_id: 8"), "joint 3 (motor 3)", "does not answer"),
        (CUBEMARS, ("load_code: 100", "load_code: 101"), "force sensor", "load_code"),
    ],
)  # fmt: skip
def test_device_that_contradicts_the_robot_file_is_named(path, built, subject, words):
    (found,) = failures(examined(path, as_built=changed(path, built)))
    assert found.subject == subject
    assert words in found.text
    assert found.remedy


@pytest.mark.parametrize("path", [DYNAMIXEL, ODRIVE, CUBEMARS], ids=lambda path: path.stem)
def test_reversed_joint_is_found_without_power(path, plants):
    built = changed(path, (", reversed: true}", "}"))
    findings = examined(path, as_built=built, move=True, may_power=lambda: True)
    if "limits" not in failures(findings)[0].text:  # mirrored, it may stand outside of its limits already
        (found,) = failures(findings)
        assert found.subject == "sign of joint 2"
        assert "reversed" in found.remedy
    assert not np.any(plants)


def test_doctor_detects_a_reversed_force_sensor():
    built = changed(DYNAMIXEL, ("capacity_n: 100.0", "capacity_n: 100.0, reversed: true"))
    (found,) = failures(examined(DYNAMIXEL, as_built=built, move=True))
    assert found.subject == "sign of the force"


class LazyHand(EmulatedOperator):
    """Turns when it is told to, and presses not at all."""

    def press(self, words):
        self.rest()


class LastingHand(EmulatedOperator):
    """Stays on the tool when it is told to leave it."""

    def rest(self):
        if not self._pressing:
            super().rest()


class ReturningHand(EmulatedOperator):
    """Comes back while the seconds until the power are counted."""

    def count(self, left_s):
        if left_s == 1:
            self.press("")
            self.advance(1.0)


class ThoroughHand(EmulatedOperator):
    """Finishes a turn that has been seen long ago, and begins the next one only then."""

    _unfinished, _turned, _next = 0, None, None

    def turn(self, joint, words):
        self._next = joint

    def rest(self):
        if self._pressing:
            super().rest()
            return
        self._turned, self._unfinished, self._joint, self._next = self._joint, 25, None, None

    def advance(self, elapsed_s):
        self._world.held = True
        if self._unfinished:
            self._unfinished -= 1
            angles_rad = self._home_rad.copy()
            if self._turned is not None:
                angles_rad[self._turned] += 0.012 * self._unfinished
            self._world.place(angles_rad)
            return
        if not self._pressing:
            self._joint = self._next
        super().advance(elapsed_s)

    def press(self, words):
        super().press(words)
        self._next = None


def signs_by(hand, monkeypatch, **options):
    monkeypatch.setattr(arm_check, "EmulatedOperator", hand)
    return examined(DYNAMIXEL, move=True, **options)


@pytest.mark.parametrize(
    ("hand", "subject", "words"),
    [
        (LazyHand, "sign of the force", "too small to show the sign"),
        (LastingHand, "hands away", "remain after the press"),
        (ReturningHand, "hands away", "moves or is touched"),  # while the seconds are counted
    ],
)
def test_arm_is_not_powered_if_instructions_are_not_followed(hand, subject, words, monkeypatch, plants):
    monkeypatch.setattr(signs, "_COUNT_S", 2)  # the hand comes back in the last second, not in the first
    asked = []
    (found,) = failures(signs_by(hand, monkeypatch, may_power=lambda: asked.append(hand) or True))
    assert found.subject == subject
    assert words in found.text
    assert bool(asked) == (hand is ReturningHand)
    assert not np.any(plants)


def test_continued_turn_is_not_taken_for_the_next_joint(monkeypatch):
    assert not failures(signs_by(ThoroughHand, monkeypatch))


def test_operator_prompts_state_when_to_release_and_clear_the_arm(capsys):
    person = ArmOperator()
    person.rest()
    person.leave()
    person.count(3)
    said = capsys.readouterr().err
    assert "hold still" in said
    assert "Hands away from the arm" in said
    assert "power in 3 s" in said


@pytest.mark.parametrize("path", sorted(ROOT.glob("robots/*_3dof.yaml")), ids=lambda path: path.stem)
def test_blocked_joint_is_released_before_a_large_torque(path):
    robot_file = load_robot_file(path)
    body = RigidBody.of_robot(robot_file)
    limits = signs._reduced_limits(robot_file.limits, body)
    assert max(limits.tracking_rad) < NUDGE_RAD  # else a joint that is held would never be far enough off
    home_nm = np.abs(body.gravity(np.array(robot_file.home_rad)))
    assert np.all(np.array(limits.torque_nm) > home_nm)
    assert np.all(np.array(limits.torque_nm) < 0.5 * np.array(robot_file.limits.torque_nm))


@pytest.mark.parametrize("side", ["position_min_rad", "position_max_rad"])
def test_arm_at_its_limits_is_moved_away_from_them(side):
    robot_file = load_robot_file(DYNAMIXEL)
    limits = robot_file.limits
    start_rad = np.array(getattr(limits, side))
    task = NudgeTask(robot_file, RigidBody.of_robot(robot_file))
    zeros = np.zeros(3)
    measurement = Measurement(0.0, start_rad, zeros, zeros, 0.0, 0.0, 0.0, 0.0)
    task.start(measurement)
    outputs = [task.step(measurement, 0.01) for _ in range(450)]
    ways_rad = np.array([output.reference_position_rad for output in outputs])
    assert np.all(ways_rad >= np.array(limits.position_min_rad))
    assert np.all(ways_rad <= np.array(limits.position_max_rad))
    assert np.ptp(ways_rad, axis=0) == pytest.approx(NUDGE_RAD, rel=0.02)


def test_old_samples_do_not_show_rest():
    rest = Measurement(0.0, np.zeros(3), np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0, 0.0)
    old = rest._replace(encoder_status=Status.STALE)
    assert signs._is_still([rest, old, old])  # a sensor may be slower than it is asked
    assert not signs._is_still([old, old, old])
    assert not signs._is_still([rest, rest._replace(force_status=Status.FAULT)])


def test_small_motion_stops_when_the_tool_touches():
    robot_file = load_robot_file(DYNAMIXEL)
    task = NudgeTask(robot_file, RigidBody.of_robot(robot_file))
    rest = Measurement(0.0, np.array(robot_file.home_rad), *np.zeros((2, 3)), 0.2, 0.0, 0.0, 0.0)
    task.start(rest)
    task.step(rest, 0.01)
    touched = iter([rest._replace(force_n=8.0)] * 5)
    with pytest.raises(SafetyTripError, match="remove the obstacle"):
        list(map(partial(task.step, dt_s=0.01), touched))


def test_doctor_detects_swapped_drives():
    swapped = (("node_id: 1", "node_id: 5"), ("node_id: 2", "node_id: 1"), ("node_id: 5", "node_id: 2"))
    found = failures(examined(ODRIVE, as_built=changed(ODRIVE, *swapped), move=True))
    assert [finding.subject for finding in found] == ["sign of joint 2", "sign of joint 3"]
    assert "joint 3 moved" in found[0].text


def test_arm_heavier_than_its_urdf_shows_in_the_small_motion(plants):
    heavy = changed(
        DYNAMIXEL, ("urdf: dynamixel_3dof.urdf", "urdf: ../sim_backend/arms/follower/follower.urdf")
    )
    findings = examined(DYNAMIXEL, as_built=heavy, move=True, may_power=lambda: True)
    bad = [finding.subject for finding in findings if finding.level in {Level.WARN, Level.FAIL}]
    assert bad
    assert all(subject.startswith(("drive of", "torque of", "small motion")) for subject in bad)
    assert np.abs(plants).max() < 0.02


STOP, TORQUES = "small motion", ["torque of joint 1", "torque of joint 2"]
TWO, SERVO = ["torque of joint 1", "torque of joint 3"], "id: 2, model: XM540-W270, zero_rad: 3.14159265"
ALONE = "only the torque of joint {} contradicts the motion"


@pytest.mark.parametrize(
    ("path", "old", "new", "subjects", "words"),
    [
        (ROBSTRIDE, "3, model: RS00", "3, model: RS03", ["drive of joint 3"], "correct the drive's model"),
        (ROBSTRIDE, "3, model: RS00", "3, model: RS01", ["drive of joint 3"], "correct the drive's model"),
        (ROBSTRIDE, "1, model: RS03", "1, model: RS04", ["torque of joint 1", STOP], ALONE.format(1)),
        (ROBSTRIDE, "2, model: RS03", "2, model: RS04", ["torque of joint 2", STOP], ALONE.format(2)),
        (ROBSTRIDE, "2, reversed", "2, zero_rad: 1.5708, reversed", ["torque of joint 3", STOP], "earlier"),
        (ROBSTRIDE, "RS03, gear_ratio: 2}", "RS03, gear_ratio: 1}", TWO, "gear ratios of joints 1 to 3"),
        (DYNAMIXEL, SERVO, SERVO.replace("3.14159265", "4.7124"), TORQUES, "the faulty joint is unknown"),
    ],
)  # fmt: skip
def test_joint_that_contradicts_its_robot_file_is_blamed(path, old, new, subjects, words):
    wrong, built = changed(path, (old, new)), load_robot_file(path)
    check = ArmCheck(wrong, wired=True, as_built=built, move=True, may_power=lambda: True)
    found = failures(examine_arm(check))
    assert [finding.subject for finding in found][: len(subjects)] == subjects
    assert words in found[-1].remedy


@pytest.mark.parametrize(("old", "new", "level"), [("0.3", "0.6", Level.WARN), ("0.15", "0.75", Level.FAIL)])
def test_wrong_masses_are_graded_by_a_tolerance(tmp_path, old, new, level):
    urdf = (ROBOTS / "dynamixel_3dof.urdf").read_text(encoding="utf-8")
    wrong = urdf.replace(f'<mass value="{old}"/>', f'<mass value="{new}"/>')
    (tmp_path / "wrong.urdf").write_text(wrong, encoding="utf-8")
    robot_file = changed(
        DYNAMIXEL,
        ("urdf: dynamixel_3dof.urdf", f"urdf: {tmp_path / 'wrong.urdf'}"),
        ("dh: dynamixel_3dof.dh.yaml", ""),
    )
    built = load_robot_file(DYNAMIXEL)
    check = ArmCheck(robot_file, wired=True, as_built=built, move=True, may_power=lambda: True)
    (found,) = (finding for finding in examine_arm(check) if finding.subject == "torque of joint 1")
    assert found.level is level


@pytest.mark.parametrize(
    ("held_nm", "required_nm", "friction_nm", "level"),
    [
        (2.0, 2.0, 0.0, Level.OK),
        (2.0, 2.0, 1.0, Level.SKIP),  # friction could hide a factor of 2
        (0.01, 0.0, 0.0, Level.SKIP),
        (2.3, 2.0, 0.0, Level.OK),
        (1.0, 1.5, 0.0, Level.WARN),
        (2.0, 1.0, 0.0, Level.FAIL),
        (1.0, 2.0, 0.0, Level.FAIL),
        (1.0, 0.0, 0.0, Level.FAIL),
        (np.nan, 2.0, 0.0, Level.FAIL),
    ],
)
def test_torque_is_never_ok_where_an_error_could_not_show(held_nm, required_nm, friction_nm, level):
    assert signs._torque_finding(0, held_nm, required_nm, 0.1, friction_nm).level is level


@pytest.mark.parametrize(
    ("axis", "level", "words"),
    [
        ("[-1, 0, 0]", Level.FAIL, "back to the arm"),
        ("[0, 1, 0]", Level.FAIL, "no joint moves"),
        ("[0, 0, 1]", Level.WARN, "perpendicular to the last link"),
    ],
)
def test_wrong_sensor_axis_is_detected(axis, level, words):
    (found,) = limit_findings(changed(DYNAMIXEL, ("sensor_axis_tip: [1, 0, 0]", f"sensor_axis_tip: {axis}")))
    assert (found.subject, found.level) == ("sensor_axis_tip", level)
    assert words in found.remedy


def test_probe_names_a_reversed_sensor_axis(tmp_path):
    text = DYNAMIXEL.read_text(encoding="utf-8").replace("[1, 0, 0]", "[-1, 0, 0]")
    for kind in ("urdf", "dh"):
        text = text.replace(f"{kind}: dynamixel", f"{kind}: {ROBOTS}/dynamixel")
    (tmp_path / "arm.yaml").write_text(text, encoding="utf-8")
    refused = run("probe", "--robot", tmp_path / "arm.yaml", "--wire", "-o", tmp_path / "s.mcap")
    assert refused.exit_code == 2
    assert "if it points there already, correct sensor_axis_tip" in refused.stderr


@pytest.mark.parametrize("device", ["encoder", "torque", "force"])
def test_nonfinite_samples_are_a_failure(device):
    robot = build_mock_robot()
    robot.buses["world"].faults.not_a_number = {device}
    with robot:
        (failure,) = failures(arm_check._examine_rates(robot, mock_robot_file()))
    assert (failure.subject, failure.text) == (f"{device} samples", "some values are not finite numbers")


def test_nonfinite_press_or_turn_is_a_failure():
    assert signs._force_finding(np.nan).level is Level.FAIL
    assert signs._joint_finding(0, np.full(3, np.nan)).level is Level.FAIL


def test_force_bus_failure_does_not_affect_encoders():
    """A robot calls an encoder without a new sample faulty where any bus has failed."""
    rest = Measurement(0.0, np.zeros(3), np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0, 0.0)
    old = rest._replace(time_s=2e-3, encoder_status=Status.FAULT, force_status=Status.FAULT)

    def finding(device, bus, failed):
        fault_text = "the port was unplugged" if bus in failed else None
        return arm_check._device([(rest, set()), (old, failed)], fault_text, device, bus, 5e-3)

    assert finding("encoder", "motors", {"load_cell"}).level is Level.OK
    force = finding("force", "load_cell", {"load_cell"})
    assert force.level is Level.FAIL
    assert "unplugged" in force.text
    assert finding("encoder", "motors", {"motors", "load_cell"}).level is Level.FAIL


def test_slow_bus_is_detected_from_its_byte_count():
    slow = changed(DYNAMIXEL, ("baud_rate: 4000000", "baud_rate: 57600"))
    (found,) = failures(examine_arm(ArmCheck(slow, wired=True)))
    assert found.subject == "rate of motors"
    assert "the wire allows 47 Hz" in found.text


def limit_findings(robot_file):
    found = examine_limits(robot_file, RigidBody.of_robot(robot_file))
    return [finding for finding in found if finding.level is not Level.OK]


@pytest.mark.parametrize(
    ("old", "new", "subject", "level", "words"),
    [
        ("torque_nm: [8.0,", "torque_nm: [0.5,", "torque limits", Level.FAIL, "the arm's weight needs up to"),
        ("[0.5, 0.25, 0.03]", "[5.0, 0.25, 0.03]", "braking", Level.WARN, "damping 5, 0.25, 0.03"),
        ("[0.5, 0.25, 0.03]", "[0.5, 0.25, 3.0]", "braking", Level.FAIL, "damping 0.5, 0.25, 3"),
        ("encoder_age_s: 0.005", "encoder_age_s: 0.001", "age limits", Level.WARN, "encoder 1 ms"),
        ("encoder_age_s: 0.005", "encoder_age_s: 1.1", "age limits", Level.FAIL, "encoder 1100 ms"),
        ("force_n: 40.0", "force_n: 200.0", "force limit", Level.FAIL, "sensor's range ends at 100 N"),
        ("capacity_n: 100.0", "capacity_n: 30.0", "force limit", Level.FAIL, "ends at 30 N"),
        ("torque_nm: [8.0,", "torque_nm: [80.0,", "highest torques", Level.FAIL, "80, 8, 3 N m"),
        ("velocity_rad_s: [4.0,", "velocity_rad_s: [99.0,", "velocity limits", Level.FAIL, "99"),
        ("[3.05, 2.75,", "[3.05, 6.0,", "position limits", Level.FAIL, "joint 2"),
        ("position_min_rad: [-1.25,", "position_min_rad: [-1.5,", "position limits", Level.FAIL, "-1.5 to"),
        ("tracking_rad: [0.1,", "tracking_rad: [2.0,", "tracking limits", Level.FAIL, "2 rad"),
        ("tracking_rad: [0.1,", "tracking_rad: [0.5,", "tracking limits", Level.WARN, "0.5 rad"),
        ("[0.5, 0.25, 0.03]", "[0.0, 0.0, 0.0]", "braking", Level.FAIL, "damping 0, 0, 0"),
        ("[0.5, 0.25, 0.03]", "[0.5, 0.25, 0.0]", "braking", Level.WARN, "damping 0.5, 0.25, 0"),
        ("force_n:", "unresponsive_drive_s: 10\n  force_n:", "unresponsive_drive_s", Level.FAIL, "10000 ms"),
        ("force_n:", "stuck_encoder_s: 10\n  force_n:", "stuck_encoder_s", Level.FAIL, "10000 ms"),
        ("force_n:", "stuck_force_s: 10\n  force_n:", "stuck_force_s", Level.FAIL, "10000 ms"),
        ("force_n:", "stuck_force_s: 0.3\n  force_n:", "stuck_force_s", Level.WARN, "300 ms"),
        ("force_n:", "unresponsive_drive_s: 1e-9\n  force_n:", "unresponsive_drive_s", Level.FAIL, "tick"),
    ],
)  # fmt: skip
def test_ineffective_limit_is_detected(old, new, subject, level, words):
    (found,) = limit_findings(changed(DYNAMIXEL, (old, new)))
    assert (found.subject, found.level) == (subject, level)
    assert words in found.text
    assert found.remedy


def test_excessive_torque_limit_is_detected(tmp_path):
    urdf = (ROBOTS / "dynamixel_3dof.urdf").read_text(encoding="utf-8").replace('effort="', 'effort="10')
    (tmp_path / "strong.urdf").write_text(urdf, encoding="utf-8")
    strong = changed(
        DYNAMIXEL,
        ("urdf: dynamixel_3dof.urdf", f"urdf: {tmp_path / 'strong.urdf'}"),
        ("torque_nm: [8.0, 8.0,", "torque_nm: [80.0, 80.0,"),
    )
    (found,) = limit_findings(strong)
    assert found.subject == "highest torques"
    assert "the arm's weight needs 1.99 N m" in found.text


@pytest.mark.parametrize("path", [ODRIVE, CUBEMARS], ids=lambda path: path.stem)
def test_capacity_of_each_shipped_sensor_is_known(path):
    found = failures(limit_findings(changed(path, ("force_n: 60.0", "force_n: 100.0"))))
    assert [finding.subject for finding in found] == ["force limit"]


def test_massless_arm_is_detected(tmp_path):
    urdf = (ROBOTS / "dynamixel_3dof.urdf").read_text(encoding="utf-8")
    (tmp_path / "light.urdf").write_text(
        re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL), encoding="utf-8"
    )
    light = changed(DYNAMIXEL, ("urdf: dynamixel_3dof.urdf", f"urdf: {tmp_path / 'light.urdf'}"))
    (found,) = examine_limits(light, RigidBody.of_robot(light))
    assert found.level is Level.FAIL
    assert "moves no mass" in found.text


OWN = """
from typing import ClassVar
from palpate.robot_io.interfaces import ForceSensor

class BadGauge(ForceSensor):
    name: ClassVar[str] = "bad_gauge"

    def __init__(self, settings, context):
        {made}

    def read_force(self):
        return None
"""


def with_own_driver(tmp_path, monkeypatch, made="pass"):
    module = f"own_{abs(hash(made))}"
    (tmp_path / f"{module}.py").write_text(OWN.format(made=made), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    text = ODRIVE.read_text(encoding="utf-8").replace("driver: loadstar", "driver: bad_gauge")
    (tmp_path / "own.yaml").write_text(
        text.replace("urdf: ..", f"urdf: {ROOT}").replace("dh: ..", f"dh: {ROOT}")
    )
    return ("--robot", tmp_path / "own.yaml"), module


def test_user_driver_that_cannot_be_built_is_bad_input_with_its_line(tmp_path, monkeypatch):
    robot, module = with_own_driver(tmp_path, monkeypatch, made="1 / 0")
    said = run("doctor", *robot, "--drivers", module)
    assert said.exit_code == 2
    for words in ("own.yaml line", "force.driver", "ZeroDivisionError", f"{module}.py, line 9"):
        assert words in said.stderr


def test_user_driver_that_fails_is_a_finding_with_its_line(monkeypatch):
    def configure(_):
        raise KeyError("rate")

    monkeypatch.setattr(MockForce, "configure", configure)
    (found,) = failures(arm_check._examine_devices(build_mock_robot(), mock_robot_file(), set()))
    assert found.subject == "force sensor"
    assert "its driver fails, KeyError: 'rate' (test_doctor_arm.py, line " in found.text


def test_user_sensor_cannot_be_emulated_and_a_missing_driver_is_named_first(tmp_path, monkeypatch):
    robot, module = with_own_driver(tmp_path, monkeypatch)
    assert_refused(
        run("doctor", *robot, "--wire", "--drivers", module), "own.yaml", "load_cell", "omit --wire"
    )
    missing = "no force sensor driver is called 'bad_gauge'"
    assert_refused(run("probe", *robot, "--wire", "-o", tmp_path / "s.mcap"), missing)
    assert_refused(run("doctor", *robot, "--wire"), "own.yaml line", missing)


def test_failing_packages_are_located(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "falling").mkdir()
    (tmp_path / "falling" / "__init__.py").write_text("\n1 / 0\n", encoding="utf-8")
    asked = ("doctor", "--robot", ODRIVE, "--wire", "--drivers")
    assert_refused(run(*asked, "falling.drivers"), "ZeroDivisionError", "falling/__init__.py, line 2")
    assert_refused(run(*asked, "falling.py"), "without .py")
    assert_refused(run(*asked, "no_such.drivers"), "no such package")


def test_arm_far_from_home_is_refused_with_a_remedy():
    elsewhere = changed(DYNAMIXEL, ("home_rad: [1.1573,", "home_rad: [1.6573,"))
    built = load_robot_file(DYNAMIXEL)
    (found,) = (
        f for f in examine_arm(ArmCheck(elsewhere, wired=True, as_built=built)) if f.subject == "home"
    )
    assert found.level is Level.WARN
    assert "joint 1 is farthest from home_rad, by -0.50 rad" in found.text
    (found,) = (f for f in examined(DYNAMIXEL) if f.subject == "home")
    assert found.level is Level.OK


def test_large_zero_shifts_are_reported(monkeypatch):
    applied = Calibrations(encoder=calibration_of("encoder", load_robot_file(DYNAMIXEL)))
    monkeypatch.setattr(arm_check, "load_calibrations", lambda *_, **__: applied)
    (found,) = (finding for finding in examined(DYNAMIXEL) if finding.subject == "zeros")
    assert found.level is Level.WARN
    assert "joint 3 by +0.3 rad" in found.text


def test_invalid_gains_are_refused_in_the_same_words(tmp_path):
    path = tmp_path / "arm.yaml"
    text = ODRIVE.read_text(encoding="utf-8").replace("urdf: ..", f"urdf: {ROOT}")
    path.write_text(text.replace("dh: ..", f"dh: {ROOT}") + "\ngains: {a: 1}\n", encoding="utf-8")
    doctor = run("doctor", "--robot", path, "--wire")
    assert_refused(doctor, "arm.yaml line", "gains.a", "is not known")
    assert doctor.stderr == run("probe", "--robot", path, "--wire", "-o", tmp_path / "s.mcap").stderr


def test_missing_port_is_a_failure_with_a_remedy():
    found = failures(finding for _, finding in arm_check._examine_ports(load_robot_file(ODRIVE)))
    assert [finding.subject for finding in found] == ["port of motors", "port of load_cell"]
    assert "ip link set can0 up" in found[0].remedy


def test_command_shows_findings_and_next_steps():
    result = done("doctor", "--robot", ODRIVE, "--wire", "--move", "--yes")
    assert "ok    joint 2 (node 1)" in result.stdout
    assert "'odrive_3dof' passes all checks" in result.stdout
    assert result.stderr.index("palpate calibrate") < result.stderr.index("palpate probe --robot")
    page = (ROOT / "docs" / "how-to" / "hardware.md").read_text(encoding="utf-8")
    assert FIRST_PROBE in result.stderr
    assert FIRST_PROBE in page  # one advice


def test_ctrl_c_during_the_small_motion_is_reported(monkeypatch):
    step, ticks = NudgeTask.step, itertools.count()

    def pressed(task, measurement, dt_s):
        if next(ticks) == 800:
            signal.raise_signal(signal.SIGINT)
        return step(task, measurement, dt_s)

    monkeypatch.setattr(NudgeTask, "step", pressed)
    result = run("doctor", "--robot", ODRIVE, "--wire", "--move", "--yes")
    assert result.exit_code == 130
    assert AT_REST in result.stderr
    assert next(ticks) == 801  # it was moving, and then no more


def test_declined_power_is_not_reported_as_passed(monkeypatch):
    monkeypatch.setattr("palpate.commands.doctor._has_terminal", lambda: True)
    monkeypatch.setattr("typer.confirm", lambda question, **_: "Hands away" not in question)
    result = run("doctor", "--robot", ODRIVE, "--wire", "--move")
    assert "passes the checks that need no power" in result.stdout
    assert "passes all checks" not in result.stdout
    assert "--wire --move" in result.stderr
    assert "palpate probe" not in result.stderr


def next_lines(result):
    return result.stderr.split("Next\n")[1]


def test_next_command_repeats_the_given_options(tmp_path, monkeypatch):
    robot, module = with_own_driver(tmp_path, monkeypatch)
    spaced = tmp_path / "my arm.yaml"
    spaced.write_text(robot[1].read_text(encoding="utf-8").replace("bad_gauge", "loadstar"), encoding="utf-8")
    typed = ("doctor", "--robot", spaced, "--wire", "--drivers", module, "--as-built")
    same = f"doctor --robot '{spaced}' --wire --as-built '{spaced}' --drivers {module}"
    assert f"{same} --move" in next_lines(run(*typed, spaced))
    other = tmp_path / "other.yaml"
    other.write_text(spaced.read_text(encoding="utf-8").replace("node_id: 1", "node_id: 9"), encoding="utf-8")
    said = next_lines(run(*typed, other, "--move", "--yes"))
    assert f"--as-built {other} --drivers {module} --move" in said


def test_simulated_arm_is_probed_and_a_failure_is_exit_code_1_also_as_json():
    assert "probe --robot follower  " in next_lines(run("doctor", "--robot", "follower"))
    result = run("doctor", "--robot", DYNAMIXEL, "--json")  # no such port on this machine
    assert result.exit_code == 1
    found = json.loads(result.stdout)["findings"]
    assert any(finding["subject"] == "port of motors" and finding["level"] == "fail" for finding in found)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--wire",), "--robot"),
        (("--robot", "follower", "--wire"), "without devices"),
        (("--robot", DYNAMIXEL, "--as-built", DYNAMIXEL), "--wire"),
        (("--robot", DYNAMIXEL, "--as-built", ODRIVE, "--wire", "--move"), "--yes"),
        (("--robot", DYNAMIXEL, "--as-built", ODRIVE, "--wire"), "{'motors': 'odrive_bus'"),
        (("--robot", DYNAMIXEL, "--move"), "terminal"),
        (("--robot", DYNAMIXEL, "--move", "--yes"), "real arm"),
        (("--robot", "nobody.yaml"), "nobody.yaml"),
    ],
)
def test_bad_input_is_one_line(arguments, word):
    assert_refused(run("doctor", *arguments), word)
