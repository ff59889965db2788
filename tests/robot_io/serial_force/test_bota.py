"""Bota sensors: frames against the emulator, damage, time stamps and refusals."""

from contextlib import nullcontext

import pytest

from palpate.robot_io.drivers.serial_force import bota
from palpate.robot_io.drivers.serial_force.bota import BotaStream, crc16, decode_frame
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators.serial_sensors import INVALID, OVERRANGE, RAW, SKIPPED, bota_frame
from tests.wire.parts import BOTA, ODRIVE

ONES = [1.0, -2.0, 3.0, 4.0, 5.0, 6.0]


def test_crc_is_that_of_x25():
    assert crc16(b"123456789") == 0x906E  # the check value of CRC-16/X-25


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_nonnumeric_value_is_refused(value):
    with pytest.raises(ProtocolError, match="not a number"):
        decode_frame(bota_frame(0, [*ONES[:5], value], 0))


def fed(*frames, axis="y"):
    """What is made of frames that follow one at time 0, which does not count yet."""
    stream = BotaStream(axis, 100.0)
    assert stream.feed(bota_frame(0, ONES, 0)) == []
    return stream, stream.feed(b"".join(frames))


@pytest.mark.parametrize(("axis", "force_n"), [("x", 1.0), ("y", -2.0), ("z", 3.0)])
def test_chosen_axis_is_read(axis, force_n):
    assert fed(bota_frame(0, ONES, 1250), axis=axis)[1] == [force_n]


@pytest.mark.parametrize("cut", range(1, 37, 5))
def test_reader_resynchronizes_after_a_truncated_frame(cut):
    _, forces = fed(bota_frame(0, [0xAA] * 6, 10)[cut:], bota_frame(0, ONES, 1250), bota_frame(0, ONES, 2500))
    assert forces == [-2.0, -2.0]


def test_noise_is_removed_from_the_saved_answer():
    stream, _ = fed(b"\x55" * 100_000)
    assert len(stream._frames.pending) == 0


@pytest.mark.parametrize(
    ("times_us", "taken"),
    [
        ([1250, 2500], 2),
        ([1250, 1250], 1),
        ([2500, 1250], 1),
        ([2500, 1250, 3750], 2),
        ([1250, 900_000], 2),
        ([1250, 2_000_000], 1),  # a frame that was damaged beyond its CRC, or a long pause:
        ([1250, 2_000_000, 2_001_250], 2),  # it was a pause
        ([1250, 2_000_000, 2500], 2),  # it was not
    ],
)
def test_stopped_time_is_accepted_after_the_next_sample(times_us, taken):
    stream, forces = fed(*(bota_frame(0, ONES, time_us) for time_us in times_us))
    assert len(forces) == taken
    assert stream.rejected == 1 + len(times_us) - taken
    assert not stream.fault_text


def test_clock_wraps_after_71_minutes_and_a_restart_is_named():
    stream = BotaStream("y", 100.0)
    times_us = (2**32 - 2250, 2**32 - 1000, 250)
    assert stream.feed(b"".join(bota_frame(0, ONES, time_us) for time_us in times_us)) == [-2.0, -2.0]
    assert not stream.fault_text
    stream, _ = fed(*(bota_frame(0, ONES, time_us) for time_us in (10_000, 2**32 - 10_000, 2**32 - 8_750)))
    assert "has restarted" in stream.fault_text


@pytest.mark.parametrize(
    ("status", "forces", "said"),
    [
        (OVERRANGE, [-100.0], ""),
        (SKIPPED, [], ""),
        (INVALID, [], "the sensor says 'invalid measurements'"),
        (RAW | OVERRANGE, [], "the sensor says 'raw measurements'"),
        (1 << 9, [], "the sensor says 'unknown bits 0x200'"),
    ],
)
def test_status_is_saturation_an_error_or_a_lost_sample(status, forces, said):
    stream, found = fed(bota_frame(status, ONES, 1250))
    assert (found, stream.fault_text) == (forces, said)
    assert stream.feed(bota_frame(0, ONES, 2500)) == [-2.0]
    assert not stream.fault_text


def test_sensor_that_keeps_skipping_is_reported():
    stream, forces = fed(*(bota_frame(SKIPPED, ONES, 1250 * k) for k in range(1, 6)))
    assert (forces, stream.fault_text) == ([], "the sensor says 'skips measurements; lower rate_hz'")
    assert stream.feed(bota_frame(0, ONES, 7500)) == [-2.0]
    assert not stream.fault_text


def test_single_frame_is_no_force():
    """One in 65 536 of the places in another device's bytes that look like a frame has the CRC of one."""
    noise = b"\x55\xaa\x55" * 100
    assert BotaStream("y", 100.0).feed(noise + bota_frame(0, ONES, 123_456) + noise) == []


@pytest.fixture
def arm(make_robot):
    return make_robot(ODRIVE, BOTA)


def test_sensor_is_configured_according_to_the_robot_file(arm):
    heard, receive = [], arm.sensor.receive
    arm.sensor.receive = lambda data, now_s: heard.append(data) or receive(data, now_s)
    arm.robot.configure()
    assert heard == [b"C", b"c,0,1,0,4", b"f,64,0,0,1", b"R"]
    times_s = {arm.tick(None).force_at_s for _ in range(80)}
    assert len(times_s) == pytest.approx(80 * arm.period_s * 800, rel=0.05)


def test_restarted_sensor_gives_no_valid_force(arm):
    """Its stored settings may differ; it was named, and its forces were used."""
    arm.robot.configure()
    arm.ticks(10, None)
    arm.sensor._time_us = 0.0
    arm.ticks(10, None)
    for _ in range(10):
        assert arm.tick(None).force_status is Status.FAULT
    assert "the sensor has restarted" in arm.problem


@pytest.mark.parametrize("refused", ["C", "c", "f", "R"])
def test_refused_command_is_named(arm, refused):
    arm.sensor.refused = refused
    with pytest.raises(DeviceError, match=f"the sensor refuses '{refused}.*', code 1"):
        arm.robot.configure()


@pytest.mark.parametrize(("starts_s", "said"), [(3.4, None), (3.6, "no answer to 'C'; check port")])
def test_starting_sensor_is_waited_for(arm, starts_s, said, monkeypatch):
    """In a tenth of the time."""
    monkeypatch.setattr(bota, "_ANSWER_S", bota._ANSWER_S / 10.0)
    first_asked_s = arm.clock.now_s() + 0.075  # after the motors
    arm.sensor.starts_until_s = first_asked_s + starts_s / 10.0
    with pytest.raises(DeviceError, match=said) if said else nullcontext():
        arm.robot.configure()


def test_line_that_is_too_slow_is_refused(make_robot):
    slow = (*BOTA[:1], ("baud_rate: 230400", "baud_rate: 115200"))
    with pytest.raises(DeviceError, match="115200 bit/s cannot carry"):
        make_robot(ODRIVE, slow).robot.configure()


def test_commands_are_those_of_the_maker():
    assert bota.setup_commands(9600, 100) == (b"C", b"c,0,1,0,0", b"f,512,0,0,1", b"R")
    assert bota.setup_commands(460_800, 800)[2] == b"f,64,0,0,1"
    assert bota.find_answer_code(b"f,512,0,0,1", b"\xaar,0,C,0 r,0,f,") is None
    assert bota.find_answer_code(b"f,512,0,0,1", b"\xaar,0,C,0 r,0,f,0") == 0
