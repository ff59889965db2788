import math
from datetime import timedelta

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.calibration.applied import (
    CalibratedForceSensor,
    Calibrations,
    gravity_base_m_s2,
    load_calibrations,
    parse_calibrations,
)
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import InputError
from palpate.robot_io.examination import Examinable, ok
from palpate.robot_io.interfaces import ForceSensor
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import load_robot_file, parse_robot_file
from palpate.robot_io.types import Command, Reading, Status
from tests.mock_robot import ROBOT_YAML, mock_bus
from tests.robot_io.calibration.parts import END, KINDS, MADE, NOW, VALUES, quantities, quantity, robot_with


def readings(robot_file, calibrations, command_nm=(0.2, 0.3, 0.4)):
    """A measurement after a command, and what was said to be sent and was sent."""
    clock = SimulatedClock()
    with build_robot(robot_file, DriverCatalog("tests.mock_robot"), clock, calibrations) as robot:
        robot.activate()
        for _ in range(3):
            clock.sleep_until(clock.now_s() + 0.001)
            measurement = robot.read(clock.now_s() + 0.001)
            sent = robot.write(Command(np.array(command_nm)), clock.now_s() + 0.001)
        return measurement, sent.joint_torque_nm, mock_bus(robot).staged_nm


def test_readings_and_commands_are_corrected_once(tmp_path):
    robot_file = robot_with(tmp_path, *KINDS)
    raw, _, _ = readings(robot_file, Calibrations())
    seen, sent, told = readings(robot_file, load_calibrations(robot_file, NOW))
    force = VALUES["force"]
    above = raw.force_n - force["zero"]["value"]
    expected = force["scale"]["value"] * above + force["curvature"]["value"] * above**2
    assert seen.force_n == pytest.approx(expected)
    offset = np.array(VALUES["encoder"]["offset"]["value"])
    np.testing.assert_allclose(seen.joint_position_rad, raw.joint_position_rad + offset, atol=1e-3)
    np.testing.assert_allclose(seen.joint_velocity_rad_s, raw.joint_velocity_rad_s, atol=0.1)
    # (0.2 - 0)/0.5, (0.3 - 0.1)/1, (0.4 + 0.2)/2
    np.testing.assert_allclose(told, [0.4, 0.2, 0.3], atol=0.005)
    np.testing.assert_allclose(sent, [0.2, 0.3, 0.4], atol=0.01)
    assert seen.encoder_at_s == raw.encoder_at_s
    assert seen.force_status is raw.force_status


def test_measured_torque_is_that_of_the_joint(tmp_path):
    robot_file = robot_with(tmp_path, "torque")
    seen, _, told = readings(robot_file, load_calibrations(robot_file, NOW))
    gain, offset = (np.array(VALUES["torque"][name]["value"]) for name in ("gain", "offset"))
    raw, _, _ = readings(robot_file, Calibrations(), told)
    np.testing.assert_allclose(seen.joint_torque_nm, gain * raw.joint_torque_nm + offset, atol=1e-9)


def test_robot_file_is_never_built_without_its_calibrations(tmp_path):
    robot_file = robot_with(tmp_path, "force")
    (tmp_path / "force.yaml").unlink()
    with pytest.raises(InputError, match=r"mock\.yaml line \d+, .*force: .*force\.yaml: cannot be"):
        build_robot(robot_file, DriverCatalog("tests.mock_robot"), SimulatedClock())
    with pytest.raises(InputError, match=r"force\.yaml"):
        RigidBody.of_robot(robot_file)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("force", {"robot": "other"}, ("'other'", "this is")),
        ("force", {"device": {"driver": "loadstar", "capacity_n": 100.0}}, ("loadstar", "mock_force")),
        ("force", {"reading_unit": "count"}, ("count",)),
        ("torque", {"urdf_sha256": "1" * 64}, ("a URDF other than", "palpate calibrate torque")),
    ],
)
def test_foreign_calibration_is_refused(tmp_path, kind, change, words):
    if "reading_unit" in change:
        units = {"zero": "count", "scale": "N/count", "curvature": "N/count^2"}
        values = {name: VALUES[kind][name] | {"unit": unit} for name, unit in units.items()}
        change = change | {"values": values}
    robot_file = robot_with(tmp_path, kind, **change)
    with pytest.raises(InputError) as caught:
        load_calibrations(robot_file, NOW)
    text = str(caught.value)
    for word in (*words, f"calibration.{kind}", f"'{kind}.yaml'", " line "):
        assert word in text


@pytest.mark.parametrize("kind", KINDS)
def test_emulated_calibration_is_for_emulated_devices_alone(tmp_path, kind):
    robot_file = robot_with(tmp_path, kind, source="emulated")
    with pytest.raises(InputError, match=rf"made with emulated devices .* palpate calibrate {kind}"):
        load_calibrations(robot_file, NOW)
    with pytest.raises(InputError, match="emulated devices"):
        build_robot(robot_file, DriverCatalog("tests.mock_robot"), SimulatedClock())
    assert load_calibrations(robot_file, NOW, emulated=True).kinds == (kind,)


def test_calibration_without_reading_unit_is_not_applied(tmp_path):
    robot_file = robot_with(tmp_path, "force", source=None)
    with pytest.raises(
        InputError, match="does not state its 'source', so it may have been made with emulated devices"
    ):
        load_calibrations(robot_file, NOW)
    text = (tmp_path / "force.yaml").read_text()
    assert "source" not in text
    assert parse_calibrations("force:\n" + "".join(f"  {line}\n" for line in text.splitlines())).force


def test_changed_device_setting_makes_a_calibration_foreign(tmp_path):
    robot_file = robot_with(tmp_path, "force")
    text = robot_file.path.read_text()
    changed = text.replace("driver: mock_force", "driver: mock_force, capacity_n: 50")
    assert changed != text
    robot_file.path.write_text(changed)
    with pytest.raises(InputError, match="capacity_n was None and is 50"):
        load_calibrations(load_robot_file(robot_file.path), NOW)


def torque_values(**changes):
    return VALUES["torque"] | {name: quantities(values, "N m") for name, values in changes.items()}


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (
            "force",
            VALUES["force"] | {"zero": quantity(1e6, "N")},
            "has a zero offset of 8e.05 N; .* at most 15 N",
        ),
        ("force", VALUES["force"] | {"curvature": quantity(-0.02, "N/N^2")}, "curvature .* 0.004 N/N"),
        ("torque", torque_values(command_offset=[0.0, -500.0, 0.0]), "command_offset of -500 N m"),
        ("torque", torque_values(offset=[0.0, 0.0, 99.0]), "offset of 99 N m for joint 3; .* at most"),
    ],
)
def test_calibration_that_would_mislead_the_guard_is_refused(tmp_path, kind, values, words):
    robot_file = robot_with(tmp_path, kind, values=values)
    with pytest.raises(InputError, match=words):
        load_calibrations(robot_file, NOW)


@pytest.mark.parametrize("sign", [1, -1])
def test_strongest_accepted_curvature_still_shows_the_guard_its_limit(tmp_path, sign):
    values = VALUES["force"] | {"curvature": quantity(sign * 0.004, "N/N^2")}
    robot_file = robot_with(tmp_path, "force", values=values)
    limit_n = robot_file.limits.force_n

    class Sensor:
        reading_n = 0.0

        def read_force(self):
            return Reading(np.array([self.reading_n]), 0.0, Status.OK)

    sensor = Sensor()
    calibrated = CalibratedForceSensor(sensor, load_calibrations(robot_file, NOW).force)
    seen = []
    for sensor.reading_n in np.linspace(0, 4 * limit_n, 200):
        seen.append(abs(calibrated.read_force().value[0]))
    beyond = np.array(seen) >= limit_n
    assert beyond[np.argmax(beyond) :].all()  # once past the limit it stays past it


def test_calibration_does_not_hide_the_sensor_identity(tmp_path):
    calibration = load_calibrations(robot_with(tmp_path, "force"), NOW).force

    class Silent(ForceSensor):
        def read_force(self):
            return Reading(np.array([0.0]), 0.0, Status.OK)

    class Named(Silent, Examinable):
        def examine(self):
            return (ok("force sensor", "DI-1000"),)

        def tick_wire_s(self):
            return 1e-4

    named, silent = CalibratedForceSensor(Named(), calibration), CalibratedForceSensor(Silent(), calibration)
    assert isinstance(named, Examinable)
    assert [seen.text for seen in named.examine()] == ["DI-1000"]
    assert named.tick_wire_s() == 1e-4
    assert silent.examine() == ()
    assert silent.tick_wire_s() is None


def test_commanded_torque_never_exceeds_the_limit(tmp_path):
    robot_file = robot_with(tmp_path, "torque")
    largest = np.array(robot_file.limits.torque_nm)
    _, sent, told = readings(robot_file, load_calibrations(robot_file, NOW), command_nm=tuple(0.9 * largest))
    assert np.all(np.abs(told) <= largest)
    gain, offset = (np.array(VALUES["torque"][name]["value"]) for name in ("gain", "command_offset"))
    np.testing.assert_allclose(sent, gain * told + offset, atol=1e-9)  # and what was sent is said


def test_expired_or_mismatched_calibration_is_refused(tmp_path):
    robot_file = robot_with(tmp_path, "force")
    assert load_calibrations(robot_file, END - timedelta(seconds=1)).force is not None
    with pytest.raises(InputError, match="expired on 2027-11-20; make a new one: palpate calibrate force"):
        load_calibrations(robot_file, END)
    with pytest.raises(InputError, match="set the clock"):
        load_calibrations(robot_file, MADE - timedelta(minutes=6))
    assert load_calibrations(robot_file, MADE - timedelta(minutes=4)).force is not None  # another clock
    robot_file = robot_with(tmp_path, "force", "encoder")
    (tmp_path / "force.yaml").write_text((tmp_path / "encoder.yaml").read_text())
    with pytest.raises(InputError, match="kind 'encoder'"):
        load_calibrations(robot_file, NOW)
    two = {"offset": {"value": [0.1, 0.2], "std_err": [0.1, 0.1], "unit": "rad"}}
    robot_file = robot_with(tmp_path, "encoder", values=two)
    with pytest.raises(InputError, match="2 joints, but the robot has 3"):
        load_calibrations(robot_file, NOW)


def test_unknown_key_is_refused():
    with pytest.raises(InputError, match=r"calibration\.forse: is not known; did you mean 'force'"):
        parse_robot_file(ROBOT_YAML + "\ncalibration: {forse: a.yaml}\n", "mock.yaml")


def test_session_text_matches_the_report(tmp_path):
    found = load_calibrations(robot_with(tmp_path, *KINDS), NOW)
    again = parse_calibrations(found.text)
    assert again == found
    assert again.kinds == KINDS
    assert parse_calibrations("") == Calibrations()
    with pytest.raises(InputError, match="'spam' is not a kind of calibration"):
        parse_calibrations("spam: 1")


def test_one_kind_can_be_left_out(tmp_path):
    found = load_calibrations(robot_with(tmp_path, *KINDS), NOW, leave_out=("force",))
    assert found.kinds == ("encoder", "torque", "gravity")


@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (0.0, -0.2), (-0.3, 0.25)])
def test_gravity_is_rotated_by_the_base(pitch, roll):
    about_y = np.array(
        [[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]
    )
    about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    expected = (about_y @ about_x).T @ [0, 0, -9.81]
    np.testing.assert_allclose(gravity_base_m_s2(pitch, roll), expected, atol=1e-12)


def test_tilted_base_changes_the_arm_s_weight(tmp_path):
    robot_file = robot_with(tmp_path, "gravity")
    level = RigidBody.of_robot(robot_file, Calibrations())
    tilted = RigidBody.of_robot(robot_file, load_calibrations(robot_file, NOW))
    posture, dipped = np.array([-1.0, 0.4, 0.9]), np.array([-0.95, 0.4, 0.9])  # by 0.05 rad, axes along +y
    np.testing.assert_allclose(tilted.gravity(posture), level.gravity(dipped), rtol=1e-9)
    assert abs(level.gravity(posture)[0] / level.gravity(dipped)[0] - 1.0) > 0.01
