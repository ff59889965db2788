"""Whole undamaged answers are decoded at once, with the result of packet-wise decoding."""

import numpy as np
import pytest

from palpate.robot_io.drivers.dynamixel.servos import decode_feedback
from palpate.robot_io.drivers.feetech.feedback import FEEDBACK_SIZE
from palpate.robot_io.drivers.feetech.protocol import AROUND, FeetechStatusReader
from tests.wire.parts import DYNAMIXEL, SO101

TORQUE_NM = np.array((0.9, -0.4, 0.1))
TICKS = 60


def one_by_one(reader, request, data):
    if hasattr(reader, "_replies"):
        return decode_feedback(reader._replies[request.size].decode(data))
    return reader._decode(FeetechStatusReader().feed(data))


def recorded(arm):
    """Answers of some ticks: request, bytes, and feedback that was decoded at once and one by one."""
    arm.start()
    reader, answers = arm.robot.buses["motors"]._reader, []
    decode = reader._decode_whole

    def record(request, data):
        feedback = decode(request, data)
        answers.append((request, data, feedback, one_by_one(reader, request, data)))
        return feedback

    reader._decode_whole = record
    arm.ticks(TICKS, TORQUE_NM)
    del reader._decode_whole
    return reader, answers


@pytest.mark.parametrize("robot_file", [DYNAMIXEL, SO101], ids=["dynamixel", "feetech"])
def test_batch_decoding_equals_single_decoding_and_rejects_damage(make_robot, robot_file):
    reader, answers = recorded(make_robot(robot_file))
    assert len(answers) >= TICKS
    assert [feedback for _, _, feedback, _ in answers] == [expected for *_, expected in answers]
    request, data, feedback, _ = answers[-1]
    assert reader._decode_whole(request, data) == feedback
    for place in range(len(data)):
        flipped = bytearray(data)
        flipped[place] ^= 1 << place % 8
        assert reader._decode_whole(request, bytes(flipped)) is None
        assert reader._decode_whole(request, data[:place]) is None
    assert reader._decode_whole(request, data + data[:1]) is None
    longer = next(each for size, each in reader._requests.items() if size > request.size)
    assert reader._decode_whole(longer, data) is None


def test_implausible_valid_answer_is_decoded_by_single_packets(make_robot):
    reader, answers = recorded(make_robot(SO101))
    request, data, _, _ = answers[-1]
    width = AROUND + request.size
    first, second, *others = [data[start : start + width] for start in range(0, len(data), width)]
    refused = set()
    for place in range(2, width - 1):  # id, length, error and data, with a checksum that fits
        packet = bytearray(first)
        packet[place] ^= 0x80
        packet[-1] = ~sum(packet[2:-1]) & 0xFF
        if reader._decode_whole(request, b"".join((packet, second, *others))) is None:
            refused.add(place)
    padding = request.size - FEEDBACK_SIZE
    acceleration, goal, speeds, lock, position = {6}, {7, 8}, set(range(9, 15)), {20}, {21, 22}
    in_data = acceleration | goal | speeds | lock | position
    assert refused == {2, 3} | {padding + place for place in in_data}


@pytest.mark.parametrize("robot_file", [DYNAMIXEL, SO101], ids=["dynamixel", "feetech"])
def test_answer_in_two_pieces_is_the_whole_answer(make_robot, robot_file):
    arm = make_robot(robot_file)
    arm.start()
    reader = arm.robot.buses["motors"]._reader
    wait, held = reader._port.wait, []

    def in_pieces(deadline_s):
        if held:
            return held.pop()
        data = wait(deadline_s)
        held[:] = [data[7:]] if len(data) > 7 else []
        return data[:7]

    reader._port.wait = in_pieces
    before_s = -1.0
    for _ in range(20):
        arm.tick(TORQUE_NM)
        sampled_at_s = arm.robot.buses["motors"].position.sampled_at_s
        assert sampled_at_s > before_s
        before_s = sampled_at_s
