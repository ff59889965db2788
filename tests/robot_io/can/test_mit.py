"""MIT motors against the manual's frames, and against an independent bit packer."""

import bitstruct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.drivers.mit import protocol as mit
from palpate.robot_io.drivers.mit.protocol import DamiaoFrames, MitFrames, RobstrideFrames
from palpate.robot_io.drivers.mit.settings import DIALECTS, Maker
from palpate.robot_io.errors import InputError, ProtocolError
from palpate.sim_backend.emulators.mit import CUBEMARS_LIMITS, DAMIAO_LIMITS, ROBSTRIDE_LIMITS

PROTOCOLS = {Maker.CUBEMARS: MitFrames, Maker.DAMIAO: DamiaoFrames, Maker.ROBSTRIDE: RobstrideFrames}
FRAMES, DAMIAO = MitFrames(0, {}), DamiaoFrames(0, {})
AK80_9 = DIALECTS[Maker.CUBEMARS].models["AK80-9"]


def test_special_codes_of_the_manual():
    """AK Series Actuator Driver Manual, 5.3: enter and exit motor control mode."""
    assert mit.ENTER_MOTOR_MODE.hex() == "fffffffffffffffc"
    assert mit.EXIT_MOTOR_MODE.hex() == "fffffffffffffffd"


# Position [rad], velocity [rad/s], torque [N m], as the emulators have them: they share nothing with drivers.
RANGES = {Maker.CUBEMARS: CUBEMARS_LIMITS, Maker.DAMIAO: DAMIAO_LIMITS, Maker.ROBSTRIDE: ROBSTRIDE_LIMITS}


def test_every_model_has_the_ranges_of_its_emulator():
    assert {
        maker: {
            model: (ranges.position_rad, ranges.velocity_rad_s, ranges.torque_nm)
            for model, ranges in DIALECTS[maker].models.items()
        }
        for maker in Maker
    } == RANGES


@pytest.mark.parametrize(
    ("maker", "model"),
    [(maker, model) for maker in (Maker.CUBEMARS, Maker.DAMIAO) for model in RANGES[maker]],
)
def test_full_range_of_each_model(maker, model):
    models, ranges = DIALECTS[maker].models, RANGES[maker][model]
    state = FRAMES.state(CanFrame(0, bytes.fromhex("01ffffffffff1900")), models[model])
    assert (state.position_rad, state.velocity_rad_s, state.torque_nm) == ranges
    assert state.at_range_end
    lowest = FRAMES.state(CanFrame(0, bytes.fromhex("010000000000")), models[model])
    assert (lowest.position_rad, lowest.velocity_rad_s, lowest.torque_nm) == tuple(-end for end in ranges)


@pytest.mark.parametrize(
    ("position", "velocity", "at_end"),
    [
        *((0, 2048, True), (65535, 2048, True), (32768, 0, True), (32768, 4095, True)),
        *((1, 2048, False), (65534, 2048, False), (32768, 1, False), (32768, 4094, False)),
    ],
)
@pytest.mark.parametrize(("torque", "torque_at_end"), [(0, True), (1, False), (4094, False), (4095, True)])
def test_end_of_a_range_is_known_on_either_side(position, velocity, at_end, torque, torque_at_end):
    data = bitstruct.pack("u8u16u12u12", 3, position, velocity, torque)
    state = FRAMES.state(CanFrame(0, data), AK80_9)
    assert (state.at_range_end, state.torque_at_end) == (at_end, torque_at_end)


@pytest.mark.parametrize("maker", Maker)
def test_readings_that_the_firmware_truncates_have_no_bias(maker):
    """Published firmware converts `(int)((x + range) * (2^bits - 1) / (2 * range))`."""
    model, ends = next(iter(RANGES[maker].items()))
    frames = PROTOCOLS[maker](0, {})
    lengths = (16, 16, 16) if maker is Maker.ROBSTRIDE else (16, 12, 12)
    steps = 2.0 * np.array(ends) / (2.0 ** np.array(lengths) - 1.0)
    errors = []
    for true in np.random.default_rng(0).uniform(-0.9, 0.9, (2000, 3)) * ends:
        bits = ((true + ends) / steps).astype(int).tolist()
        if maker is Maker.ROBSTRIDE:
            frame = CanFrame(0x02800100, bitstruct.pack("u16u16u16u16", *bits, 0), extended=True)
        else:
            frame = CanFrame(0, bitstruct.pack("u8u16u12u12u8u8", 0x11, *bits, 0, 0))
        state = frames.state(frame, DIALECTS[maker].models[model])
        errors.append((np.array([state.position_rad, state.velocity_rad_s, state.torque_nm]) - true) / steps)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03
    assert np.abs(errors).max() < 0.501


@given(st.floats(-30, 30))
def test_encoded_torque_matches_the_motor_resolution(torque_nm):
    frame, sent_nm = FRAMES.torque(7, torque_nm, AK80_9)
    position, velocity, stiffness, damping, torque = bitstruct.unpack("u16u12u12u12u12", frame.data)
    assert (frame.can_id, stiffness, damping) == (7, 0, 0)
    assert (abs(position - 65535 / 2), abs(velocity - 4095 / 2)) == (0.5, 0.5)  # zero, but for rounding
    assert sent_nm == pytest.approx(-18 + 36 * torque / 4095)
    assert abs(sent_nm - min(max(torque_nm, -18), 18)) <= 18 / 4095 + 1e-9


def test_zero_torque_is_half_a_step_off_zero():
    assert abs(FRAMES.torque(7, 0.0, AK80_9)[1]) == pytest.approx(18 / 4095)


@pytest.mark.parametrize("length", [0, 5, 9])
def test_wrong_length_is_refused(length):
    with pytest.raises(ProtocolError, match="expected 6 or 7 or 8"):
        FRAMES.state(CanFrame(0, bytes(length)), AK80_9)


def test_nonfinite_torque_is_refused():
    with pytest.raises(InputError):
        FRAMES.torque(1, float("nan"), AK80_9)


DM4310 = DIALECTS[Maker.DAMIAO].models["DM-J4310"]


@pytest.mark.parametrize(
    ("first", "motor_id", "error", "enabled"),
    [(0x01, 1, 0, False), (0x11, 1, 0, True), (0xD3, 3, 13, False), (0x8F, 15, 8, False)],
)
def test_damiao_status_is_in_the_bits_above_the_id(first, motor_id, error, enabled):
    """Where others have an error there is a temperature."""
    state = DAMIAO.state(CanFrame(0x11, bytes((first, 0x80, 0, 0x80, 8, 0, 40, 35))), DM4310)
    assert (state.motor_id, state.error, state.enabled) == (motor_id, error, enabled)
    assert state.position_rad == pytest.approx(0.0, abs=1e-3)
    with pytest.raises(ProtocolError):
        DAMIAO.state(CanFrame(0x11, bytes(6)), DM4310)


def test_registers_of_the_manual():
    frames = DAMIAO
    assert frames.read_register(1, mit.CONTROL_MODE).data.hex(" ") == "01 00 33 0a 00 00 00 00"
    written = frames.write_register(0x0102, mit.TORQUE_RANGE, 10.0)
    assert (written.can_id, written.data.hex(" ")) == (0x7FF, "02 01 55 17 00 00 20 41")
    frame = CanFrame(0x11, bytes.fromhex("0201331700002041"))
    assert frames.register_value(frame, 0x0102, mit.TORQUE_RANGE) == 10.0
    wrong = ((frame, 1, mit.TORQUE_RANGE), (frame, 0x0102, mit.DAMIAO_CAN_TIMEOUT))
    for answer, motor_id, register in (*wrong, (written, 0x0102, mit.TORQUE_RANGE)):
        with pytest.raises(ProtocolError):
            frames.register_value(answer, motor_id, register)


def test_errors_have_names():
    assert DIALECTS[Maker.CUBEMARS].error_names(4) == "under voltage"
    assert DIALECTS[Maker.CUBEMARS].error_names(99) == "unknown error 99"
