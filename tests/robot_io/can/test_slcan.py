"""Serial CAN adapter: frames, their age, damage, and the duration of a poll."""

import fcntl
import os
import sys
import termios
import time
import tty
from itertools import pairwise

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.clock import MonotonicClock, SimulatedClock
from palpate.robot_io.drivers.can.line import CanFrame, CanLine, CanLineSettings, decode_line, encode_line
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.serial_port import SerialPort

OPENING = b"\rC\rS8\rO\r"


class Adapter:
    """Both ends of a serial line; `line` is ours."""

    def __init__(self, clock):
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path, self.clock = os.ttyname(self._slave), clock
        self.line = self.another()

    def another(self, **changes):
        settings = {"interface": "slcan", "channel": self.path, "bitrate": 1_000_000} | changes
        return CanLine(CanLineSettings(**settings), self.clock)

    def says(self, data):
        """Bytes, once they can be read at our end: the kernel takes its time."""
        before = self._waiting()
        os.write(self.master, data)
        give_up_s = time.monotonic() + 5.0
        while self._waiting() < before + len(data) and time.monotonic() < give_up_s:
            time.sleep(1e-4)

    def _waiting(self):
        return int.from_bytes(fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)), sys.byteorder)

    def close(self):
        self.line.close()
        os.close(self._slave)
        os.close(self.master)


@pytest.fixture
def adapter():
    made = Adapter(SimulatedClock())
    made.line.open()
    assert os.read(made.master, 100) == OPENING
    yield made
    made.close()


def frames(line):
    return [frame for frame, _ in line.drain(1.0)]


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t0212AABB", CanFrame(0x21, b"\xaa\xbb")),
        (b"t7FF0", CanFrame(0x7FF)),
        (
            b"T1ABCDEF0801020304050607ff",
            CanFrame(0x1ABCDEF0, bytes((1, 2, 3, 4, 5, 6, 7, 255)), extended=True),
        ),
        (b"r0218", CanFrame(0x21, remote=True)),
        (b"t02120102BEEF", CanFrame(0x21, b"\x01\x02")),  # with a time stamp
    ],
)
def test_frames_of_the_manual(adapter, line, frame):
    adapter.says(line + b"\r")
    assert frames(adapter.line) == [frame]


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_encoded_message_is_decodable(can_id, data, is_extended):
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=is_extended)
    line = encode_line(message)
    assert line.isascii()
    assert line.endswith(b"\r")
    assert decode_line(line[:-1]).equals(message, timestamp_delta=None)


@pytest.mark.parametrize(
    "damage", [b"\x80", b"\x00\xff", b"t0212AAB", b"T00zz", b"t9991FF", b"t0219" + bytes(9), b"x" * 99]
)
def test_damage_loses_only_one_line(adapter, damage):
    """One byte 0x80 once deafened the line for good; what came after a damaged line looked newer."""
    adapter.clock.sleep_until(1.0)
    adapter.says(b"t0211AA\r" + damage + b"\rz\r\rt0211BB\r\a")
    assert adapter.line.drain(1.0) == [(CanFrame(0x21, b"\xaa"), 0.0), (CanFrame(0x21, b"\xbb"), 0.0)]
    assert adapter.line.counts["damaged"] == 1


def test_frames_are_parsed_from_any_chunks(adapter):
    found = []
    for byte in b"t0211AA\rt0211BB\r":
        adapter.says(bytes((byte,)))
        found += frames(adapter.line)
    assert found == [CanFrame(0x21, b"\xaa"), CanFrame(0x21, b"\xbb")]


def test_buffered_samples_have_their_largest_possible_age(adapter):
    adapter.line.drain(0.0)
    adapter.says(b"t0211AA\r")
    adapter.clock.sleep_until(0.55)
    assert adapter.line.drain(0.55)[0][1] == 0.0
    adapter.says(b"t0211AA\r")
    assert adapter.line.drain(0.55)[0][1] == 0.55


def test_empty_poll_does_not_wait():
    adapter = Adapter(MonotonicClock())
    adapter.line.open()
    try:
        looks_s = [time.monotonic()]
        for _ in range(200):
            adapter.line.drain(0.0)
            looks_s.append(time.monotonic())
        assert min(b - a for a, b in pairwise(looks_s)) < 5e-4  # python-can waits for 1.1 ms each time
    finally:
        adapter.close()


def test_frame_is_sent_whole_or_reported_unsent(adapter):
    """The output is blocked: what was torn is ended before the next frame."""
    adapter.line.send(CanFrame(0x123, b"\x01\xff"), 0.0)
    assert os.read(adapter.master, 100) == b"t123201FF\r"

    def fill():
        for _ in range(10_000):
            adapter.line.send(CanFrame(0x123, bytes(8)), 0.0)

    with pytest.raises(DeviceError, match="blocked"):
        fill()
    heard = b""
    while not heard.endswith(b"t0210\r"):
        try:
            heard += os.read(adapter.master, 65536)
        except BlockingIOError:
            adapter.line.send(CanFrame(0x21), 0.0)
    *whole, torn, last, end = heard.split(b"\r")
    assert set(whole) == {b"t1238" + b"00" * 8}
    assert whole[0].startswith(torn)
    assert (last, end) == (b"t0210", b"")


@pytest.mark.parametrize(
    ("bitrate", "code"),
    [
        *((10_000, b"S0\r"), (20_000, b"S1\r"), (50_000, b"S2\r"), (100_000, b"S3\r"), (125_000, b"S4\r")),
        *((250_000, b"S5\r"), (500_000, b"S6\r"), (1_000_000, b"S8\r"), (None, b"")),
    ],
)
def test_bit_rates_of_the_manual(adapter, bitrate, code):
    adapter.line.close()
    os.read(adapter.master, 100)
    line = adapter.another(bitrate=bitrate)
    line.open()
    assert os.read(adapter.master, 100) == b"\rC\r" + code + b"O\r"
    line.close()
    assert os.read(adapter.master, 100) == b"C\r"  # off the bus


def test_adapter_has_one_owner_and_checks_its_settings(adapter):
    with pytest.raises(DeviceError, match="another program has it"):
        adapter.another().open()
    adapter.line.close()
    for changes, problem in (
        ({"bitrate": 33_333}, "Valid: 10000"),
        ({"channel": f"{adapter.path}@fast"}, "give a baud rate like 3000000, not 'fast'"),
        ({"options": {"sleep_after_open": 0}}, "sleep_after_open"),
    ):
        with pytest.raises(DeviceError, match=problem):
            adapter.another(**changes).open()
    again = adapter.another()
    again.open()
    again.close()


def test_unplugged_adapter_is_a_failure():
    adapter = Adapter(SimulatedClock())
    adapter.line.open()
    os.close(adapter.master)
    with pytest.raises(DeviceError, match="unplugged"):
        adapter.line.drain(0.0)
    os.close(adapter._slave)


def test_port_that_takes_no_commands_can_be_opened_again(adapter, monkeypatch):
    adapter.line.close()

    def blocked(_port, data):
        raise DeviceError(f"took 0 of {len(data)} bytes; its output is blocked")

    with monkeypatch.context() as patched:
        patched.setattr(SerialPort, "write", blocked)
        with pytest.raises(DeviceError, match="output is blocked") as kept:
            adapter.line.open()
    other = adapter.another()
    other.open()
    other.close()
    assert kept.value  # which holds what failed
