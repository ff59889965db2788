"""Robstride's frames and moteus' registers against examples of the makers and independent packers."""

import math
import struct

import bitstruct
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.drivers import moteus
from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.drivers.mit.protocol import (
    ROBSTRIDE_CAN_TIMEOUT,
    RUN_MODE,
    MotorCommand,
    MotorRegister,
    RobstrideFrames,
)
from palpate.robot_io.drivers.mit.settings import DIALECTS, Maker
from palpate.robot_io.errors import InputError, ProtocolError

FRAMES = RobstrideFrames(0xFD, {})
RS03 = DIALECTS[Maker.ROBSTRIDE].models["RS03"]


def said(frame):
    return f"{frame.can_id:08X} {frame.data.hex(' ')}" if frame.extended else "a short id"


@pytest.mark.parametrize(
    ("frame", "bytes_"),
    [
        # The manual, 4.1.14; a recording in sirwart/robstride#2, with host AA; the manual, 4.1.3 and 4.1.4.
        (
            FRAMES.read_register(0x7F, MotorRegister("loc_kp", 0x701E, "<f")),
            "1100FD7F 1e 70 00 00 00 00 00 00",
        ),
        (RobstrideFrames(0xAA, {}).write_register(2, RUN_MODE, 1), "1200AA02 05 70 00 00 01 00 00 00"),
        (FRAMES.write_register(1, ROBSTRIDE_CAN_TIMEOUT, 20000), "1200FD01 28 70 00 00 20 4e 00 00"),
        (FRAMES.order(1, MotorCommand.ENTER), "0300FD01 00 00 00 00 00 00 00 00"),
        (FRAMES.order(1, MotorCommand.LEAVE), "0400FD01 00 00 00 00 00 00 00 00"),
        (FRAMES.order(1, MotorCommand.CLEAR), "0400FD01 01 00 00 00 00 00 00 00"),
    ],
)
def test_frames_match_recorded_ones(frame, bytes_):
    assert said(frame) == bytes_


@given(st.floats(-100, 100))
def test_torque_is_encoded_in_the_id_with_zero_gains(torque_nm):
    frame, sent_nm = FRAMES.torque(7, torque_nm, RS03)
    kind, torque, motor = bitstruct.unpack("p3u5u16u8", frame.can_id.to_bytes(4, "big"))
    assert (kind, motor, frame.data[4:]) == (1, 7, bytes(4))
    assert sent_nm == pytest.approx(-60 + 120 * torque / 65535)
    assert abs(sent_nm - min(max(torque_nm, -60), 60)) <= 60 / 65535 + 1e-9


@given(*(st.integers(0, 65535) for _ in range(3)), st.integers(0, 2), st.integers(0, 63))
def test_state_matches_a_bit_packer(position, velocity, torque, mode, faults):
    can_id = int.from_bytes(bitstruct.pack("p3u5u2u6u8u8", 2, mode, faults, 9, 0xFD), "big")
    frame = CanFrame(can_id, bitstruct.pack("u16u16u16u16", position, velocity, torque, 251), extended=True)
    assert FRAMES.sender(frame) == 9
    state = FRAMES.state(frame, RS03)
    assert (state.motor_id, state.enabled, state.error) == (9, mode == 2, faults)
    read = (state.position_rad, state.velocity_rad_s, state.torque_nm)
    for value, bits, span in zip(read, (position, velocity, torque), (8 * math.pi, 40, 120), strict=True):
        truncated = -span / 2 + span * bits / 65535  # the true value is up to a step higher
        assert value - truncated == pytest.approx(span / 65535 / 2 if 0 < bits < 65535 else 0.0, abs=1e-9)


def test_faults_have_manual_names_and_an_unread_parameter_is_no_zero():
    """Recorded from an RS03 in huggingface/lerobot#4070: index 1003, which it does not know."""
    frame = CanFrame(0x110115FD, bytes(8), extended=True)
    with pytest.raises(ProtocolError, match="110115FD"):
        FRAMES.register_value(frame, 0x15, MotorRegister("unknown", 0x1003, "<f"))
    # 4.1.2, bits 16 to 21 of a state's id; 4.1.8, of a fault frame's first four bytes.
    state = "under voltage, over current, over temperature, encoder fault, overload, stalled, "
    assert DIALECTS[Maker.ROBSTRIDE].error_names(0x3F) == state + "encoder not calibrated"
    names = (
        "over temperature; driver chip; under voltage; over voltage; over current in phase B; "
        "over current in phase C; encoder not calibrated; hardware not identified; "
        "position not initialized; overload, stalled; over current in phase A"
    )
    for bit, name in zip((0, 1, 2, 3, 4, 5, 7, 8, 9, 14, 16), names.split("; "), strict=True):
        alarm = FRAMES.alarm(CanFrame(0x150001FD, (1 << bit).to_bytes(8, "little"), extended=True))
        assert DIALECTS[Maker.ROBSTRIDE].error_names(alarm) == name
    two = FRAMES.alarm(CanFrame(0x150001FD, bytes.fromhex("0a00000000000000"), extended=True))
    assert DIALECTS[Maker.ROBSTRIDE].error_names(two) == "driver chip, over voltage"
    assert DIALECTS[Maker.ROBSTRIDE].error_names(alarm := 1 << 28) == "unknown fault, bit 20"
    assert FRAMES.alarm(CanFrame(0x150001FD, (1 << 20).to_bytes(8, "little"), extended=True)) == alarm


QUESTION = "11001f0110040c"
ANSWER = bytes.fromhex("21000a2f010000803e0000c0bf0000004020040c02301f00")


@pytest.mark.parametrize(
    ("frame", "data"),
    [  # Controller(id=3) with int8 position and gains, int16 watchdog: make_position, make_stop, make_query
        (moteus.encode_torque(0, 3, 1.5, 0.1), "01000a0120800d220000c03f0223000005276400012b00" + QUESTION),
        (moteus._frame(0, 3, moteus._STOP), "010000" + QUESTION),
        (moteus._frame(0, 3, moteus._ASK), QUESTION),
    ],
)
def test_encoding_matches_the_vendor_library(frame, data):
    assert frame.data.hex().startswith(data)
    assert (frame.can_id, frame.extended, frame.fd) == (0x8003, True, True)
    assert len(frame.data) in (8, 12, 16, 20, 24, 32)
    assert set(frame.data[len(data) // 2 :]) == {0x50}


def test_answers_decode_like_the_vendor_library():
    state = moteus.decode_state(CanFrame(0x300, ANSWER, fd=True))
    assert (state.mode, state.position_rev, state.velocity_rev_s, state.torque_nm) == (10, 0.25, -1.5, 2.0)
    assert (state.home, state.supply_v, state.temperature_c, state.fault) == (2, 24.0, 31, 0)
    assert not state.unknown
    assert not state.error


@pytest.mark.parametrize("place", [0, 1, 3, 4, 17, 18, 19])
def test_answer_of_another_form_is_refused(place):
    other = bytearray(ANSWER)
    other[place] ^= 1
    for data in (bytes(other), ANSWER[:-1], ANSWER + b"\x50"):
        with pytest.raises(ProtocolError):
            moteus.decode_state(CanFrame(0x300, data, fd=True))


@pytest.mark.parametrize(
    ("values", "unknown"),
    [
        ((float("nan"), 0, 0), "its position is nan"),
        ((0, float("inf"), 0), "its speed is inf"),
        ((float("inf"), 0, -float("inf")), "its position is inf, its torque is -inf"),
    ],
)
def test_nonfinite_values_are_named(values, unknown):
    data = ANSWER[:5] + struct.pack("<3f", *values) + ANSWER[17:]
    assert moteus.decode_state(CanFrame(0x300, data, fd=True)).unknown == unknown


@pytest.mark.parametrize(
    ("mode", "fault", "error"), [(0, 0, 0), (10, 99, 0), (11, 0, 11), (1, 38, 38), (1, 0, 1), (4, 0, 0)]
)
def test_fault_counts_only_in_fault_mode(mode, fault, error):
    data = ANSWER[:2] + bytes((mode,)) + ANSWER[3:-1] + bytes((fault,))
    assert moteus.decode_state(CanFrame(0x300, data, fd=True)).error == error


@pytest.mark.parametrize("torque_nm", [float("nan"), float("inf")])
def test_nonfinite_torque_is_refused(torque_nm):
    with pytest.raises(InputError):
        moteus.encode_torque(0, 1, torque_nm, 0.1)
