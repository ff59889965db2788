"""moteus' registers against frames that mjbots' own library (moteus 1.1.1 from PyPI) made and understood."""

import struct

import pytest

from robot_io.drivers import moteus
from robot_io.drivers.can.line import CanFrame
from robot_io.errors import InputError, ProtocolError

QUESTION = "11001f0110040c"
ANSWER = bytes.fromhex("21000a2f010000803e0000c0bf0000004020040c02301f00")


@pytest.mark.parametrize(
    ("frame", "data"),
    [  # Controller(id=3) with int8 position and gains, int16 watchdog: make_position, make_stop, make_query
        (moteus.encode_torque(0, 3, 1.5, 0.1), "01000a0120800d220000c03f0223000005276400012b00" + QUESTION),
        (moteus.encode_stop(0, 3), "010000" + QUESTION),
        (moteus.encode_question(0, 3), QUESTION),
    ],
)
def test_what_is_sent_is_what_the_vendor_s_library_sends(frame, data):
    assert frame.data.hex().startswith(data)
    assert (frame.can_id, frame.extended, frame.fd) == (0x8003, True, True)
    assert len(frame.data) in (8, 12, 16, 20, 24, 32)
    assert set(frame.data[len(data) // 2 :]) == {0x50}


def test_what_is_answered_means_what_the_vendor_s_library_says():
    state = moteus.decode_state(CanFrame(0x300, ANSWER, fd=True))
    assert (state.mode, state.position_rev, state.velocity_rev_s, state.torque_nm) == (10, 0.25, -1.5, 2.0)
    assert (state.home, state.supply_v, state.temperature_c, state.fault) == (2, 24.0, 31, 0)
    assert state.is_known
    assert not state.error


@pytest.mark.parametrize("place", [0, 1, 3, 4, 17, 18, 19])
def test_an_answer_of_another_form_is_refused(place):
    other = bytearray(ANSWER)
    other[place] ^= 1
    for data in (bytes(other), ANSWER[:-1], ANSWER + b"\x50"):
        with pytest.raises(ProtocolError):
            moteus.decode_state(CanFrame(0x300, data, fd=True))


@pytest.mark.parametrize("values", [(float("nan"), 0, 0), (0, float("inf"), 0), (0, 0, -float("inf"))])
def test_what_is_not_finite_is_not_known(values):
    data = ANSWER[:5] + struct.pack("<3f", *values) + ANSWER[17:]
    assert not moteus.decode_state(CanFrame(0x300, data, fd=True)).is_known


@pytest.mark.parametrize(
    ("mode", "fault", "error"), [(0, 0, 0), (10, 99, 0), (11, 0, 11), (1, 38, 38), (1, 0, 1), (4, 0, 0)]
)
def test_a_fault_counts_in_the_mode_of_faults(mode, fault, error):
    data = ANSWER[:2] + bytes((mode,)) + ANSWER[3:-1] + bytes((fault,))
    assert moteus.decode_state(CanFrame(0x300, data, fd=True)).error == error


@pytest.mark.parametrize("torque_nm", [float("nan"), float("inf")])
def test_no_number_is_refused(torque_nm):
    with pytest.raises(InputError):
        moteus.encode_torque(0, 1, torque_nm, 0.1)
