"""Emulated motors and sensors against manuals, cantools with our DBC, and a bit packer."""

import struct
from pathlib import Path

import bitstruct
import can
import cantools
import pytest

from palpate.robot_io.drivers.mit.settings import MitBusSettings
from palpate.robot_io.drivers.odrive import OdriveBusSettings
from palpate.robot_io.drivers.serial_force.gauges import ForceLinesSettings, LoadstarSettings
from palpate.robot_io.drivers.serial_force.lorenz import LorenzSettings
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.emulators.hardware import Plant
from palpate.sim_backend.emulators.mit import EmulatedMitMotor
from palpate.sim_backend.emulators.odrive import EmulatedOdrive
from palpate.sim_backend.emulators.serial_sensors import EmulatedGauge, EmulatedLoadstar, EmulatedLorenz
from palpate.sim_backend.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[3]
DBC = ROOT / "tests" / "robot_io" / "can"


@pytest.fixture
def plant():
    made = Plant(
        load_robot_file(ROOT / "robots" / "odrive_3dof.yaml"), load_scenario("default", ROOT), start_s=0.0
    )
    made.advance_to(0.01)
    yield made
    made.close()


def frame(can_id, data=b"", *, remote=False):
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote)


def odrive(plant, firmware="0.6", **details):
    axis = {"node_id": 1, "gear_ratio": 9.0, "reversed": True, "zero_rad": 0.1, "max_torque_nm": 2.0}
    axis |= {"torque_constant_nm_a": 0.5}
    settings = OdriveBusSettings(interface="virtual", channel=0, firmware=firmware, axes=[axis], **details)
    return EmulatedOdrive(settings.axes[0], 0, plant, settings)


def mit_motor(plant):
    motor = {"motor_id": 3, "model": "AK70-10"}
    settings = MitBusSettings(interface="virtual", channel=0, motors=[motor])
    return EmulatedMitMotor(settings.motors[0], 0, plant, settings)


def arm(node, now_s=0.01):
    node.receive(frame(0x2B, struct.pack("<II", 1, 1)), now_s)
    node.receive(frame(0x27, struct.pack("<I", 8)), now_s)


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_axis_messages_match_the_dbc_file(plant, firmware):
    node = odrive(plant, firmware)
    database = cantools.database.load_file(DBC / f"odrive_0_{firmware[2]}.dbc")
    told = {}
    for message in node.send_unrequested(0.2):
        told[database.get_message_by_frame_id(message.arbitration_id).name] = database.decode_message(
            message.arbitration_id, bytes(message.data)
        )
    assert told["Heartbeat"]["Axis_State"] == 1
    assert told["Heartbeat"]["Axis_Error"] == 0
    assert told["Encoder_Estimates"]["Pos_Estimate"] == pytest.approx(
        -9 * (plant.joints[0].position_rad - 0.1) / 6.283185307, abs=1e-4
    )
    assert set(told) == {"Heartbeat", "Encoder_Estimates", "Iq" if firmware == "0.5" else "Torques"}


def test_axis_follows_torque_only_in_closed_loop_control_within_its_limit(plant):
    node = odrive(plant)
    torque = frame(0x2E, struct.pack("<f", -1.0))
    node.receive(torque, 0.01)
    assert not plant.world.truth().drive_torque_nm.any()
    arm(node)
    node.receive(torque, 0.01)
    plant.advance_to(0.012)
    assert plant.world.truth().drive_torque_nm[0] == pytest.approx(9.0)
    node.receive(frame(0x2E, struct.pack("<f", -50.0)), 0.012)
    assert plant.world.truth().drive_torque_nm[0] == pytest.approx(18.0)


def test_axis_without_commands_disarms_and_rearms_only_after_clearing(plant):
    node = odrive(plant, watchdog_s=0.05)
    arm(node)
    node.receive(frame(0x2E, struct.pack("<f", -1.0)), 0.01)
    node.send_unrequested(0.06)
    assert node.state == 8
    node.send_unrequested(0.0605)
    assert (node.state, node.error) == (1, 1 << 24)
    assert not plant.world.truth().drive_torque_nm.any()
    arm(node, 0.061)
    assert node.state == 1
    node.receive(frame(0x38, b"\x00"), 0.061)
    arm(node, 0.061)
    assert node.state == 8


def test_only_0_6_answers_get_version_and_a_motor_each_frame_with_its_state(plant):
    (answer,) = odrive(plant).receive(frame(0x20, remote=True), 0.0)
    assert bytes(answer.data)[4:7] == bytes((0, 6, 10))
    assert odrive(plant, "0.5").receive(frame(0x20, remote=True), 0.0) == []
    assert odrive(plant).receive(frame(0x40, remote=True), 0.0) == []  # another node
    motor = mit_motor(plant)
    (answer,) = motor.receive(frame(3, b"\xff" * 7 + b"\xfc"), 0.01)
    number, position, velocity, torque, _, error = bitstruct.unpack("u8u16u12u12u8u8", bytes(answer.data))
    assert (answer.arbitration_id, number, error) == (0, 3, 0)
    assert -12.5 + 25 * position / 65535 == pytest.approx(plant.joints[0].position_rad, abs=4e-4)
    assert -50 + 100 * velocity / 4095 == pytest.approx(0.0, abs=0.03)
    assert -25 + 50 * torque / 4095 == pytest.approx(0.0, abs=0.05)
    assert motor.receive(frame(4, b"\xff" * 8), 0.01) == []
    assert motor.receive(frame(3, b"\xff" * 7), 0.01) == []


def test_enabled_motor_exerts_its_feedforward_torque_and_gains(plant):
    motor = mit_motor(plant)
    push = bitstruct.pack("u16u12u12u12u12", 32768, 2048, 0, 0, 3000)
    motor.receive(frame(3, push), 0.01)
    assert not plant.world.truth().drive_torque_nm.any()
    motor.receive(frame(3, b"\xff" * 7 + b"\xfc"), 0.01)
    motor.receive(frame(3, push), 0.01)
    plant.advance_to(0.011)
    assert plant.world.truth().drive_torque_nm[0] == pytest.approx(-25 + 50 * 3000 / 4095)
    spring = bitstruct.pack("u16u12u12u12u12", 32768, 2048, 82, 0, 2048)  # 10 N m/rad towards zero
    motor.receive(frame(3, spring), 0.011)
    assert plant.world.truth().drive_torque_nm[0] == pytest.approx(
        -10.0 * plant.joints[0].position_rad, rel=0.02
    )
    motor.send_unrequested(0.12)
    assert not plant.world.truth().drive_torque_nm.any()


def test_emulated_load_cell_follows_its_manual():
    sensor = EmulatedLoadstar(LoadstarSettings(capacity_n=100.0))
    assert sensor.receive(b"\r", 0.0) == b"A\r\n"
    assert b"DI-1000" in sensor.receive(b"MODEL\r", 0.0)
    assert sensor.receive(b"UNI", 0.0) + sensor.receive(b"TS\r", 0.0) == b"lb\r\n"
    assert float(sensor.receive(b"LC\r", 0.0)) == pytest.approx(100.0 / 4.44822, rel=1e-4)
    assert not sensor.due(0.0)
    assert sensor.receive(b"wc\r", 0.0) == b""
    assert [sensor.due(time_s) for time_s in (0.001, 0.002, 0.003, 0.004)] == [False, True, False, True]
    assert sensor.reading(4.4482216152605) == b"      1.0000\r\n"
    sensor.receive(b"\r", 0.005)
    assert not sensor.due(0.006)


def test_lorenz_sensor_answers_hello_and_streams_until_three_stx():
    load = {"nominal_load": 100.0, "unit": "N", "counts_at_nominal": 20000.0}
    sensor = EmulatedLorenz(LorenzSettings(**load, dimension_code=3, load_code=100))
    hello = bytes.fromhex("024001ff00400202")  # summed by hand, see the codec's test
    assert sensor.receive(hello, 0.0)[:5] == bytes((2, 0x40, 0xFF, 1, 1))
    assert sensor.receive(hello[:-1] + b"\x07", 0.0) == b""  # wrong checksum
    start = bytes.fromhex("02 5a 01 ff 05 03 05 00 00 41")
    plain = sum(start[1:]) & 0xFF
    weighted = running = 0
    for byte in start[1:]:
        running = (running + byte) & 0xFF
        weighted += running
        weighted -= 255 if weighted > 255 else 0
    assert sensor.receive(start + bytes((plain, weighted)), 0.0)[:2] == bytes((2, 6))
    assert sensor.due(0.001)
    assert sensor.reading(50.0) == b"\x00" + (10000).to_bytes(2, "big")
    assert sensor.reading(-100.0) == b"\x01" + (-20000).to_bytes(2, "big", signed=True)
    sensor.receive(b"\x02\x02\x02", 0.001)
    assert not sensor.due(0.002)


def test_gauge_streams_unasked_and_stops_after_a_restart():
    gauge = EmulatedGauge(ForceLinesSettings(pattern="(?P<value>.*) N", capacity_n=100.0))
    assert gauge.due(1.0)
    assert gauge.reading(-2.5) == b"-2.500 N\r\n"
    gauge.restart(1.0, 0.5)
    assert not gauge.due(1.4)
    assert gauge.due(1.6)
