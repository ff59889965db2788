"""Emulated Dynamixel servos against the e-manual.

The last tests let the vendor's SDK be the client, over the pseudo terminal and in real time.
"""

import select
from math import pi

import pytest
import serial
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from palpate.robot_io.clock import MonotonicClock
from palpate.sim_backend.emulators import dynamixel
from palpate.sim_backend.emulators.dynamixel import DynamixelMounting, EmulatedDynamixelLine
from palpate.sim_backend.emulators.hardware import HardwareEmulator, JointState

BYTE_S = 10 / 4e6
HAND_ON_S = 0.04  # real time that a pseudo terminal may take


class Joints:
    """A plant of joints that stand where they are put."""

    def __init__(self, *angles_rad):
        self.joints = [JointState(angle, 0.0, 0.0) for angle in angles_rad]
        self.torque_nm = [0.0] * len(angles_rad)

    def set_torque(self, joint, torque_nm):
        self.torque_nm[joint] = torque_nm

    def advance_to(self, time_s):
        pass

    def close(self):
        pass


class Client:
    """The other end of a line, in time that this class lets pass."""

    def __init__(self, ids=(1, 2, 3), faults=None, model="XM430-W350"):
        self.plant = Joints(*[0.1 * servo_id for servo_id in ids])
        mountings = [DynamixelMounting(id=servo_id, model=model) for servo_id in ids]
        self.line = EmulatedDynamixelLine(mountings, self.plant, faults, baud_rate=4_000_000)
        self.port = serial.Serial(self.line.path, 4_000_000, timeout=0)
        self.now_s = 0.0

    def say(self, text, wait_s=0.01):
        """Send a packet written in hex, without its checksum; returns what comes back within `wait_s`."""
        packet = bytes.fromhex(text)
        self.port.write(packet + dynamixel.checksum(packet).to_bytes(2, "little"))
        select.select([self.line._port._fd], [], [], HAND_ON_S)
        return self.listen(wait_s)

    def listen(self, wait_s):
        self.line.receive(self.now_s)
        self.now_s += wait_s
        self.line.send(self.now_s)
        return self.received()

    def received(self):
        """What has come; the kernel hands bytes on when it finds the time."""
        data, hung_up = b"", False
        while not hung_up and select.select([self.port], [], [], HAND_ON_S if not data else HAND_ON_S / 4)[0]:
            some = self.port.read(1000)
            data, hung_up = data + some, not some
        return data

    def read(self, servo_id, address, size=1):
        answer = self.say(f"ff ff fd 00 {servo_id:02x} 07 00 02 {address:02x} 00 {size:02x} 00")
        return answer[8], answer[9:-2]

    def write(self, servo_id, address, *data):
        text = f"ff ff fd 00 {servo_id:02x} {5 + len(data):02x} 00 03 {address:02x} 00 "
        answer = self.say(text + bytes(byte & 0xFF for byte in data).hex())
        return answer[8] if answer else None

    def close(self):
        self.port.close()
        self.line.close()


@pytest.fixture
def client():
    client = Client()
    yield client
    client.close()


def status(servo_id, *body):
    return dynamixel.status(servo_id, body[0], bytes(body[1:]))


def test_packets_match_published_ones():
    """ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", examples of Ping, Read and Fast Sync Read."""
    assert (
        dynamixel.status(1, 0, bytes.fromhex("06 04 26")).hex(" ")
        == "ff ff fd 00 01 07 00 55 00 06 04 26 65 5d"
    )
    assert dynamixel.status(1, 0, bytes.fromhex("a6 00 00 00")).hex(" ") == (
        "ff ff fd 00 01 08 00 55 00 a6 00 00 00 8c c0"
    )
    parts = [(3, 0, b"\xa6\0\0\0"), (7, 0, b"\x1f\x08\0\0"), (4, 0, b"\xff\x03\0\0")]
    assert dynamixel.fast_status(parts, 3).hex(" ") == (
        "ff ff fd 00 fe 19 00 55 00 03 a6 00 00 00 84 08 00 07 1f 08 00 00 16 ca 00 04 ff 03 00 00 d1 9e"
    )


def test_published_requests_are_understood():
    request = bytes.fromhex("ff ff fd 00 fe 11 00 83 74 00 04 00 01 96 00 00 00 02 aa 00 00 00 82 87")
    understood = dynamixel.parse_instruction(bytearray(b"\xff\xff\xfd\xfd noise " + request))
    assert (understood.target, understood.code, understood.intact) == (0xFE, 0x83, True)
    assert understood.parameters == request[8:-2]


def test_ping_is_answered_and_a_damaged_request_gets_a_crc_error(client):
    assert client.say("ff ff fd 00 02 03 00 01") == status(2, 0, 0xFC, 0x03, 46)  # 1020
    everybody = client.say("ff ff fd 00 fe 03 00 01")
    assert everybody == b"".join(status(servo_id, 0, 0xFC, 0x03, 46) for servo_id in (1, 2, 3))
    assert client.say("ff ff fd 00 09 03 00 01") == b""
    client.port.write(bytes.fromhex("ff ff fd 00 01 03 00 01 19 4f"))
    assert client.listen(0.01) == status(1, 3)


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (64, (2,), 4),  # torque enable is 0 or 1
        (102, (1,), 5),  # goal current has two bytes
        (102, (0xFF, 0x7F), 6),  # beyond the current limit
        (126, (0, 0), 7),  # present current can be read only
        (70, (0,), 7),
        (66, (0,), 7),  # nothing is there
        (98, (-1,), 4),
        (98, (128,), 4),
    ],
)
def test_forbidden_write_is_refused(client, address, data, error):
    assert client.write(1, address, *data) == error


def test_eeprom_is_locked_while_torque_is_on_and_unknown_requests_are_errors(client):
    assert client.write(1, 11, 0) == 0
    assert client.write(1, 64, 1) == 0
    assert client.write(1, 11, 3) == 7
    assert client.write(1, 64, 0) == 0
    assert client.write(1, 11, 3) == 0
    assert client.say("ff ff fd 00 01 03 00 77") == status(1, 2)
    assert client.read(1, 250, 10) == (7, b"")


def test_only_current_control_with_torque_exerts_torque(client):
    constant_nm = 0.00269 * 4.1 / 2.3
    client.write(1, 102, 100, 0)
    assert client.plant.torque_nm[0] == 0
    client.write(1, 64, 1)
    assert client.plant.torque_nm[0] == 0  # still in position mode
    client.write(1, 64, 0)
    client.write(1, 11, 0)
    client.write(1, 64, 1)
    assert client.plant.torque_nm[0] == 0  # the goal was forgotten with the mode
    client.write(1, 102, -100, -1)
    assert client.plant.torque_nm[0] == pytest.approx(-100 * constant_nm)


def test_bus_watchdog_counts_in_20_ms_and_takes_goals_only_after_clearing(client):
    client.write(1, 11, 0)
    client.write(1, 64, 1)
    client.write(1, 98, 2)
    client.write(1, 102, 50, 0)
    client.listen(0.035)
    assert client.plant.torque_nm[0] > 0
    client.listen(0.010)
    client.listen(0.001)
    assert client.plant.torque_nm[0] == 0
    assert client.read(1, 98) == (0, b"\xff")
    assert client.write(1, 102, 50, 0) == 4
    assert client.write(1, 98, 0) == 0
    assert client.write(1, 102, 50, 0) == 0


def test_reading_others_feeds_the_watchdog_too(client):
    client.write(1, 11, 0)
    client.write(1, 64, 1)
    client.write(1, 98, 2)
    client.write(1, 102, 50, 0)
    for _ in range(10):
        client.read(3, 70)
    assert client.plant.torque_nm[0] > 0


def test_position_after_power_up_is_within_one_turn(client):
    client.plant.joints[0] = JointState(pi + 3 * 2 * pi + 0.1, 0.0, 0.0)
    _, data = client.read(1, 132, 4)
    assert int.from_bytes(data, "little", signed=True) == round(0.1 * 4096 / (2 * pi))
    client.plant.joints[0] = JointState(pi + 3 * 2 * pi - 0.1, 0.0, 0.0)
    _, data = client.read(1, 132, 4)
    assert int.from_bytes(data, "little", signed=True) == -round(0.1 * 4096 / (2 * pi))


def test_reboot_clears_ram_and_keeps_eeprom(client):
    client.write(1, 9, 5)
    client.write(1, 98, 7)
    assert client.say("ff ff fd 00 01 03 00 08") == status(1, 0)
    assert client.say("ff ff fd 00 01 03 00 01") == b""
    client.now_s += 1.0
    assert client.read(1, 9) == (0, b"\x05")
    assert client.read(1, 98) == (0, b"\x00")


def test_hardware_error_sets_the_alert_and_disables_torque_until_reboot(client):
    client.write(1, 64, 1)
    client.line.servos[1].fail()
    assert client.read(1, 64) == (0x80, b"\x00")
    assert client.read(1, 70) == (0x80, b"\x20")
    assert client.write(1, 64, 1) == 0x81
    client.say("ff ff fd 00 01 03 00 08")
    client.now_s += 1.0
    assert client.write(1, 64, 1) == 0


def test_indirect_data_maps_the_configured_addresses(client):
    client.write(1, 168, 132, 0, 133, 0)
    _, direct = client.read(1, 132, 2)
    assert client.read(1, 224, 2) == (0, direct)
    client.write(1, 170, 65, 0)
    client.write(1, 225, 1)
    assert client.read(1, 65) == (0, b"\x01")
    assert client.write(1, 168, 10, 0) == 4  # EEPROM cannot be stood for


def test_bytes_take_time_on_the_line(client):
    assert client.say("ff ff fd 00 fe 09 00 82 46 00 01 00 01 02", wait_s=1e-6) == b""
    request, reply, delay_s = 16, 12, 250 * 2e-6
    client.now_s = (request + reply) * BYTE_S + delay_s + 1e-6
    client.line.send(client.now_s)
    assert client.received() == status(1, 0, 0)
    client.now_s += reply * BYTE_S + delay_s
    client.line.send(client.now_s)
    assert client.received() == status(2, 0, 0)


@pytest.fixture
def sdk(monkeypatch):
    """The SDK's port and packet handler on a line that runs in real time, on a machine that may be busy."""
    monkeypatch.setattr(PortHandler, "isPacketTimeout", lambda port: port.getTimeSinceStart() > 10e3)
    plant = Joints(0.1, -0.2, 0.3)
    line = EmulatedDynamixelLine(
        [DynamixelMounting(id=i, model="XM430-W350") for i in (1, 2, 3)], plant, baud_rate=None
    )
    emulator = HardwareEmulator(plant, [line], MonotonicClock())
    emulator.start()
    port = PortHandler(line.path)
    port.openPort()
    yield port, PacketHandler(2.0), plant
    port.closePort()
    emulator.close()


def test_sdk_finds_and_configures_the_servos(sdk):
    port, packets, _ = sdk
    assert packets.ping(port, 2) == (1020, COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 9, 0) == (COMM_SUCCESS, 0)
    assert packets.read1ByteTxRx(port, 1, 9) == (0, COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 64, 7) == (COMM_SUCCESS, 4)


@pytest.mark.parametrize("way", ["txRxPacket", "fastSyncRead"])
def test_sdk_reads_and_writes_in_groups(sdk, way):
    port, packets, plant = sdk
    for servo_id in (1, 2, 3):
        packets.write1ByteTxRx(port, servo_id, 11, 0)
        packets.write1ByteTxRx(port, servo_id, 64, 1)
    reading = GroupSyncRead(port, packets, 132, 4)
    for servo_id in (1, 2, 3):
        reading.addParam(servo_id)
    assert getattr(reading, way)() == COMM_SUCCESS
    counts = [reading.getData(servo_id, 132, 4) for servo_id in (1, 2, 3)]
    assert counts == [2048 + round(angle * 4096 / (2 * pi)) for angle in (0.1, -0.2, 0.3)]
    writing = GroupSyncWrite(port, packets, 102, 2)
    for servo_id in (1, 2, 3):
        writing.addParam(servo_id, [10 * servo_id, 0])
    assert writing.txPacket() == COMM_SUCCESS
    assert packets.ping(port, 1)[1] == COMM_SUCCESS
    assert plant.torque_nm == pytest.approx([10 * k * 0.00269 * 4.1 / 2.3 for k in (1, 2, 3)])
