"""CAN adapter: arrival times of frames, and adapter failures."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import can
import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.drivers.can.line import CanFrame, CanLine, CanLineSettings, PortLock
from palpate.robot_io.errors import DeviceError


@pytest.fixture
def ends(request):
    """A line on a virtual bus, and somebody else on it."""
    made = []

    def make(timestamps, **options):
        channel = f"{request.node.name}-{len(made)}"
        settings = CanLineSettings(
            interface="virtual", channel=channel, timestamps=timestamps, options={"preserve_timestamps": True}
        )
        line = CanLine(settings, SimulatedClock())
        line.open()
        other = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        made.append((line, other))
        return line, other, line._clock

    yield make
    for line, other in made:
        line.close()
        other.shutdown()


def send(bus, stamp=0.0, data=b"\x01", **details):
    bus.send(can.Message(arbitration_id=0x21, data=data, is_extended_id=False, timestamp=stamp, **details))


def test_robot_time_stamp_is_the_sample_time(ends):
    line, other, clock = ends("robot")
    clock.sleep_until(1.0)
    send(other, 0.4)
    assert line.drain(1.0) == [(CanFrame(0x21, b"\x01"), 0.4)]


@pytest.mark.parametrize(
    ("timestamps", "stamp", "believed"),
    [
        *(("robot", *pair) for pair in ((0.5, 1.0), (-3.0, 1.0), (1.5, 1.5), (7.0, 2.0), (1e9, 2.0))),
        ("none", 1.9, 1.0),  # its largest age
    ],
)
def test_missing_or_implausible_time_stamps_are_replaced(ends, timestamps, stamp, believed):
    line, other, clock = ends(timestamps)
    clock.sleep_until(1.0)
    assert line.drain(1.0) == []
    clock.sleep_until(2.0)
    send(other, stamp)
    assert line.drain(2.0)[0][1] == believed


@pytest.mark.parametrize("timestamps", ["robot", "none"])
def test_queued_samples_keep_their_age(ends, timestamps):
    line, other, clock = ends(timestamps)
    stamps = [1e-3 * tick for tick in range(2500)]
    for stamp in stamps:
        send(other, stamp)
    believed = []
    for now_s in (2.5, 2.501, 2.502, 2.503):
        clock.sleep_until(now_s)
        believed += [at_s for _, at_s in line.drain(now_s + 1.0)]
    assert len(believed) == 2500  # more than are taken in one go
    assert believed == (stamps if timestamps == "robot" else [0.0] * 2500)
    clock.sleep_until(2.6)
    send(other, 2.55)
    assert line.drain(2.6)[0][1] == (2.55 if timestamps == "robot" else 2.503)


def test_babbling_node_does_not_block_a_late_drain(ends):
    line, other, clock = ends("robot")
    for tick in range(250):
        send(other, 1e-3 * tick)
    clock.sleep_until(1.0)
    assert [len(line.drain(0.9)) for _ in range(3)] == [101, 101, 48]


@pytest.mark.parametrize("jump_s", [0.0, 3600.0, -3600.0])
def test_wall_clock_jump_is_bounded_by_the_polls(ends, monkeypatch, jump_s):
    line, other, clock = ends("wall")
    wall_s = 1.7e9
    monkeypatch.setattr(time, "time", lambda: wall_s)
    clock.sleep_until(1.0)
    line.drain(1.0)
    clock.sleep_until(1.01)
    send(other, wall_s + 0.006)
    wall_s += 0.01 + jump_s
    at_s = line.drain(1.01)[0][1]
    assert 1.0 <= at_s <= 1.01
    if not jump_s:
        assert at_s == pytest.approx(1.006, abs=1e-6)


def test_bus_off_lasts_until_the_adapter_restarts(ends):
    line, other, _ = ends("robot")
    send(other, is_error_frame=True)
    other.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
    for _ in range(2):
        with pytest.raises(DeviceError, match="bus-off"):
            line.drain(0.0)
        with pytest.raises(DeviceError, match="bus-off"):
            line.send(CanFrame(1), 0.0)
    other.send(can.Message(arbitration_id=0x100, is_error_frame=True, data=bytes(8)))
    assert line.drain(0.0) == []
    line.send(CanFrame(0x20, remote=True), 0.0)
    heard = other.recv(timeout=0)
    assert (heard.arbitration_id, heard.is_remote_frame, heard.dlc) == (0x20, True, 8)
    assert line.counts["error frame"] == 3


def test_ordinary_error_frame_is_only_counted(ends):
    line, other, _ = ends("robot")
    send(other, is_error_frame=True)
    send(other, is_fd=True)
    send(other)
    assert [frame for frame, _ in line.drain(0.0)] == [CanFrame(0x21, b"\x01")]
    assert line.counts == {"error frame": 1, "CAN FD": 1}


def test_closed_line_raises_an_error(ends):
    line, _, _ = ends("robot")
    line.close()
    line.close()
    for call in (lambda: line.drain(0.0), lambda: line.send(CanFrame(1), 0.0)):
        with pytest.raises(DeviceError, match="not open"):
            call()


def test_serial_port_has_one_owner_and_other_channels_need_no_lock(tmp_path):
    master, slave = os.openpty()
    port, plain = os.ttyname(slave), tmp_path / "file"
    plain.touch()
    first = PortLock(f"{port}@115200")
    with pytest.raises(DeviceError, match=f"{port}: in use by another program"):
        PortLock(port)
    for _ in range(2):
        first.release()
    PortLock(port).release()
    both = [PortLock(channel) for channel in (str(plain), str(plain), "can0", 1, 1)]
    for one in both:
        one.release()
    os.close(master)
    os.close(slave)


_HOLD = """
import sys
from palpate.robot_io.drivers.can.line import PortLock
lock = PortLock("can_test", "socketcan")
print("held", flush=True)
sys.stdin.read()
"""


def test_can_channel_has_one_program_in_which_several_devices_share_it():
    with subprocess.Popen(
        [sys.executable, "-c", _HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(DeviceError, match="in use by another program"):
            PortLock("can_test", "socketcan")
        PortLock("can_other", "socketcan").release()
        other.kill()
    first, second = (PortLock("can_test", "socketcan") for _ in range(2))
    first.release()

    def hold() -> subprocess.CompletedProcess:
        command = [sys.executable, "-c", _HOLD]
        return subprocess.run(command, check=False, stdin=subprocess.DEVNULL, capture_output=True)

    assert b"in use by another program" in hold().stderr
    second.release()
    assert hold().returncode == 0


def test_failure_to_close_an_adapter_is_reported(ends):
    line, _, _ = ends("robot")
    line._bus.shutdown()
    line._bus = SimpleNamespace(shutdown=lambda: os.close(-1))
    with pytest.raises(DeviceError, match=r"cannot be closed .*Bad file"):
        line.close()
    assert not line.is_open


def test_multicast_is_limited_to_this_machine_by_default():
    settings = CanLineSettings(interface="udp_multicast", channel="239.74.163.2")
    assert settings.bus_arguments()["hop_limit"] == 0
    far = CanLineSettings(interface="udp_multicast", channel="239.74.163.2", options={"hop_limit": 1})
    assert far.bus_arguments()["hop_limit"] == 1
