"""Feetech's packets: examples of the manual, echoes, damage, and signs."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.drivers.feetech import protocol, tables
from palpate.robot_io.drivers.feetech.protocol import FeetechStatusReader, decode_status
from palpate.robot_io.drivers.servo.stream import ServoAnswer
from palpate.robot_io.errors import ProtocolError
from palpate.sim_backend.emulators import feetech

IDS, DATA = st.integers(0, 0xFC), st.binary(max_size=40)


@pytest.mark.parametrize(
    ("packet", "bytes_of_the_manual"),
    [
        (protocol.DIALECT.read(1, 0x38, 2), "FF FF 01 04 02 38 02 BE"),
        (protocol.DIALECT.write(0xFE, 5, b"\x01"), "FF FF FE 04 03 05 01 F4"),
        (
            protocol.DIALECT.sync_write(0x2A, {k: bytes.fromhex("0008 0000 E803") for k in (1, 2, 3, 4)}),
            "FF FF FE 20 83 2A 06 01 00 08 00 00 E8 03 02 00 08 00 00 E8 03 03 00 08 00 00 E8 03 "
            "04 00 08 00 00 E8 03 58",
        ),
        (protocol.DIALECT.sync_read(0x38, 8, (1, 2)), "FF FF FE 06 82 38 08 01 02 36"),
    ],
)
def test_examples_of_the_manual(packet, bytes_of_the_manual):
    assert packet == bytes.fromhex(bytes_of_the_manual)


def test_answer_of_the_manual():
    """Position 1304 of servo 1."""
    packet = decode_status(bytes.fromhex("FF FF 01 04 00 18 05 DD"))
    assert packet == ServoAnswer(1, 0, b"\x18\x05")
    assert tables.PRESENT_POSITION.decode(packet.data) == 1304


@pytest.mark.parametrize(
    ("register", "number", "value"),
    [
        (tables.PRESENT_LOAD, 50, 50),
        (tables.PRESENT_LOAD, 1024 + 50, -50),  # read as 1074 by software that knew no bit 10
        (tables.PRESENT_POSITION, 0x8064, -100),
        (tables.PRESENT_SPEED, 0x8001, -1),
        (tables.HOMING_OFFSET, 0x0800 + 85, -85),
        (tables.PRESENT_LOAD, 1024, 0),
    ],
)
def test_sign_is_a_bit_beside_the_magnitude(register, number, value):
    data = number.to_bytes(2, "little")
    assert register.decode(data) == value
    if value:
        assert register.encode(value) == data


@pytest.mark.parametrize(
    ("register", "value"),
    [(tables.HOMING_OFFSET, 2048), (tables.GOAL_POSITION, -32768), (tables.P_GAIN, 256)],
)
def test_value_that_does_not_fit_is_refused(register, value):
    with pytest.raises(ProtocolError, match="does not fit"):
        register.encode(value)


@given(st.lists(st.tuples(IDS, st.integers(0, 0x3F), DATA), max_size=6), st.data())
def test_answers_are_parsed_from_any_chunks(answers, draw):
    stream, found, reader = b"".join(feetech.status(*answer) for answer in answers), [], FeetechStatusReader()
    while stream:
        cut = draw.draw(st.integers(1, len(stream)))
        found += reader.feed(stream[:cut])
        stream = stream[cut:]
    assert [tuple(packet) for packet in found] == answers
    assert reader.rejected == 0


@given(IDS, st.integers(0, 70), st.integers(1, 40))
def test_echo_is_no_answer(servo_id, address, size):
    """It differs from an answer in nothing but that it is what was sent."""
    request = protocol.DIALECT.read(servo_id, address, size)
    assert isinstance(decode_status(request), ServoAnswer)
    reader, answer = protocol.DIALECT.packet_reader(request), feetech.status(servo_id, 0, bytes(size))
    expected = [ServoAnswer(servo_id, 0, bytes(size))]
    assert reader.feed(request + answer) == expected
    reader = FeetechStatusReader()
    assert reader.feed(protocol.DIALECT.sync_read(40, 26, (1, 2)) + answer) == expected
    assert reader.rejected == 0


def test_echo_is_sent_once():
    """With a position sensor error, servo 1 says so of a position of 568: 38 02, as it was asked."""
    request = protocol.DIALECT.read(1, 56, 2)
    assert feetech.status(1, 2, (568).to_bytes(2, "little")) == request
    assert protocol.DIALECT.packet_reader(request).feed(2 * request) == [ServoAnswer(1, 2, b"\x38\x02")]


@pytest.mark.parametrize("servo_id", [-1, 0xFD, 0xFF])
def test_invalid_requests_are_refused(servo_id):
    with pytest.raises(ProtocolError, match="not a servo id"):
        protocol.DIALECT.ping(servo_id)
    with pytest.raises(ProtocolError, match="equal numbers"):
        protocol.DIALECT.sync_write(42, {1: b"\x00", 2: b"\x00\x00"})
    with pytest.raises(ProtocolError, match="too many"):
        protocol.DIALECT.write(1, 0, bytes(250))
