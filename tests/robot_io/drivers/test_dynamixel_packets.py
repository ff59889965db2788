"""Dynamixel codec against published vectors, the SDK where it is right, and damage."""

import pytest
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from hypothesis import example, given
from hypothesis import strategies as st

from palpate.robot_io.drivers.dynamixel import protocol
from palpate.robot_io.drivers.dynamixel.protocol import (
    BROADCAST_ID,
    DynamixelStatus,
    DynamixelStatusReader,
    FastReply,
    crc16,
    decode_status,
)
from palpate.robot_io.errors import ProtocolError
from palpate.sim_backend.emulators import dynamixel

IDS = st.integers(0, 252)
# Bytes with many headers, stuffing and near-misses among them.
TRICKY = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x01]) | st.integers(0, 255), max_size=60).map(
    bytes
)


def packet(text):
    return bytes.fromhex(text)


# ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0": examples of Ping, Read, Write, Reboot, Sync Read, Sync Write,
# Fast Sync Read (and one more of the last from the manual of the JA40).
REQUESTS = {
    "ping 1": (protocol.DIALECT.ping(1), "ff ff fd 00 01 03 00 01 19 4e"),
    "ping all": (protocol.DIALECT.ping(BROADCAST_ID), "ff ff fd 00 fe 03 00 01 31 42"),
    "read position": (protocol.DIALECT.read(1, 132, 4), "ff ff fd 00 01 07 00 02 84 00 04 00 1d 15"),
    "write position": (
        protocol.DIALECT.write(1, 116, packet("00 02 00 00")),
        "ff ff fd 00 01 09 00 03 74 00 00 02 00 00 ca 89",
    ),
    "reboot": (protocol.DIALECT.encode_packet(1, 8), "ff ff fd 00 01 03 00 08 2f 4e"),
    "sync read": (
        protocol.DIALECT.sync_read(132, 4, (1, 2)),
        "ff ff fd 00 fe 09 00 82 84 00 04 00 01 02 ce fa",
    ),
    "sync write": (
        protocol.DIALECT.sync_write(116, {1: packet("96 00 00 00"), 2: packet("aa 00 00 00")}),
        "ff ff fd 00 fe 11 00 83 74 00 04 00 01 96 00 00 00 02 aa 00 00 00 82 87",
    ),
    "fast sync read": (
        protocol.DIALECT.fast_sync_read(132, 4, (3, 7, 4)),
        "ff ff fd 00 fe 0a 00 8a 84 00 04 00 03 07 04 20 f2",
    ),
    "fast sync read, JA40": (
        protocol.DIALECT.fast_sync_read(580, 4, (1, 2)),
        "ff ff fd 00 fe 09 00 8a 44 02 04 00 01 02 72 f2",
    ),
}
ANSWERS = {
    "ping 1": ("ff ff fd 00 01 07 00 55 00 06 04 26 65 5d", 1, "06 04 26"),
    "ping 2": ("ff ff fd 00 02 07 00 55 00 06 04 26 6f 6d", 2, "06 04 26"),
    "position 1": ("ff ff fd 00 01 08 00 55 00 a6 00 00 00 8c c0", 1, "a6 00 00 00"),
    "position 2": ("ff ff fd 00 02 08 00 55 00 1f 08 00 00 ba be", 2, "1f 08 00 00"),
    "written": ("ff ff fd 00 01 04 00 55 00 a1 0c", 1, ""),
    "voltage": ("ff ff fd 00 01 06 00 55 00 77 00 c3 69", 1, "77 00"),
    "temperature": ("ff ff fd 00 02 05 00 55 00 24 8b a9", 2, "24"),
}
FAST = "ff ff fd 00 fe 19 00 55 00 03 a6 00 00 00 84 08 00 07 1f 08 00 00 16 ca 00 04 ff 03 00 00 d1 9e"
FAST_JA40 = "ff ff fd 00 fe 11 00 55 00 01 d0 07 00 00 0c 83 00 02 09 00 00 00 11 40"


@pytest.mark.parametrize(("made", "published"), REQUESTS.values(), ids=REQUESTS)
def test_requests_match_published_examples(made, published):
    assert made == packet(published)


@pytest.mark.parametrize(("published", "servo_id", "data"), ANSWERS.values(), ids=ANSWERS)
def test_published_answers_are_decoded(published, servo_id, data):
    assert decode_status(packet(published)) == DynamixelStatus(servo_id, 0, packet(data))


def test_published_fast_answers_are_decoded():
    values = {
        part.servo_id: int.from_bytes(part.data, "little")
        for part in FastReply((3, 7, 4), 4).decode(packet(FAST))
    }
    assert values == {3: 166, 7: 2079, 4: 1023}
    first, second = FastReply((1, 2), 4).decode(packet(FAST_JA40))
    assert (first.data, second.data) == (packet("d0 07 00 00"), packet("09 00 00 00"))


@given(st.binary(max_size=80))
def test_checksum_matches_the_sdk(data):
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, data, len(data))


@given(st.binary(max_size=40), st.binary(max_size=40))
def test_checksum_can_be_continued(first, second):
    assert crc16(second, crc16(first)) == crc16(first + second)


def test_sdk_destuffs_a_first_pattern_likewise():
    sent = dynamixel.status(1, 0, packet("ff ff fd 07"))
    theirs = Protocol2PacketHandler().removeStuffing(list(sent))
    assert bytes(theirs[9:13]) == decode_status(sent).data == packet("ff ff fd 07")


@example(servo_id=1, error=0, data=packet("ff ff ff ff fd ff ff ff ff ff fd"))  # the SDK gets this one wrong
@given(IDS, st.integers(0, 255), TRICKY)
def test_all_servo_packets_are_decoded(servo_id, error, data):
    sent = dynamixel.status(servo_id, error, data)
    assert b"\xff\xff\xfd" not in sent[7:-2].replace(b"\xff\xff\xfd\xfd", b"")
    assert decode_status(sent) == DynamixelStatus(servo_id, error, data)


@example(servo_id=1, code=3, parameters=packet("ff ff fd fd 00 ff ff fd"))
@given(IDS | st.just(BROADCAST_ID), st.integers(0, 252), TRICKY)
def test_emulated_servo_decodes_all_requests(servo_id, code, parameters):
    sent = protocol.DIALECT.encode_packet(servo_id, code, parameters)
    assert b"\xff\xff\xfd" not in sent[7:-2].replace(b"\xff\xff\xfd\xfd", b"")
    understood = dynamixel.parse_instruction(bytearray(sent))
    assert (understood.target, understood.code, understood.parameters) == (servo_id, code, parameters)
    assert understood.intact


@given(st.lists(st.tuples(IDS, st.integers(0, 255), TRICKY), max_size=4), st.data())
def test_answers_are_parsed_from_any_fragments(answers, data):
    stream = b"".join(dynamixel.status(*answer) for answer in answers)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    reader = DynamixelStatusReader()
    found = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += reader.feed(stream[start:end])
    assert found == [DynamixelStatus(*answer) for answer in answers]
    assert reader.rejected == 0


@given(TRICKY, IDS, TRICKY)
def test_answer_is_parsed_after_noise(noise, servo_id, data):
    """Unless the noise ends in what could be a header, whose packet would then be awaited."""
    noise = noise.replace(b"\xff\xff\xfd", b"") + b"\x00"
    if b"\xff\xff\xfd" in noise:
        return
    assert DynamixelStatusReader().feed(noise + dynamixel.status(servo_id, 0, data)) == [
        DynamixelStatus(servo_id, 0, data)
    ]


def test_answer_is_found_after_a_damaged_length_or_echo():
    endless = packet("ff ff fd 00 01 ff ff 55 00")
    good = dynamixel.status(2, 0, b"\x07")
    assert DynamixelStatusReader().feed(endless + good) == [DynamixelStatus(2, 0, b"\x07")]
    # Some adapters hear themselves.
    answer = dynamixel.status(1, 0, packet("a6 00 00 00"))
    assert DynamixelStatusReader().feed(protocol.DIALECT.read(1, 132, 4) + answer) == [decode_status(answer)]


@pytest.mark.parametrize("place", range(3))
def test_damaged_part_of_a_fast_answer_is_named(place):
    damaged = bytearray(dynamixel.fast_status([(servo_id, 0, b"abcd") for servo_id in (5, 6, 7)], 3))
    damaged[8 + 8 * place + 3] ^= 1
    with pytest.raises(ProtocolError, match=rf"servo {5 + place}'s part"):
        FastReply((5, 6, 7), 4).decode(bytes(damaged))


def test_foreign_and_short_answers_are_no_part_of_a_fast_answer():
    reply = FastReply((1, 2), 2)
    swapped = dynamixel.fast_status([(2, 0, b"ab"), (1, 0, b"cd")], 2)
    with pytest.raises(ProtocolError, match="servo 2 answered in place of servo 1"):
        reply.decode(swapped)
    cut = dynamixel.fast_status([(1, 0, b"ab")], 2)
    assert reply.answered(cut) == 1
    with pytest.raises(ProtocolError):
        reply.decode(cut)


def test_alert_bit_and_error_number_are_separated():
    assert DynamixelStatus(1, 0x80, b"").alert
    assert DynamixelStatus(1, 0x80, b"").refusal is None
    assert "range" in DynamixelStatus(1, 0x84, b"").refusal
    assert "9" in DynamixelStatus(1, 0x09, b"").refusal


@pytest.mark.parametrize("count", [0, 250, 300, 600])
def test_packet_length_field_matches_its_length(count):
    packet = protocol.DIALECT.encode_packet(1, 3, bytes(count))
    assert int.from_bytes(packet[5:7], "little") == len(packet) - 7 == 1 + count + 2


def test_invalid_requests_are_refused():
    with pytest.raises(ProtocolError, match="253"):
        protocol.DIALECT.encode_packet(253, 1)
    with pytest.raises(ProtocolError, match="exceeds the limit"):
        protocol.DIALECT.encode_packet(1, 3, bytes(2000))
    with pytest.raises(ProtocolError, match="equal numbers"):
        protocol.DIALECT.sync_write(102, {1: b"ab", 2: b"c"})
