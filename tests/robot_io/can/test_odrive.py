"""CANSimple against published vectors and against cantools with a DBC of our own."""

from pathlib import Path

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.drivers import odrive_protocol as odrive
from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.drivers.odrive_protocol import AxisState, Firmware, OdriveCommand, axis_error_names
from palpate.robot_io.errors import InputError, ProtocolError

DBC = {
    firmware: cantools.database.load_file(Path(__file__).with_name(f"odrive_0_{firmware[2]}.dbc"))
    for firmware in Firmware
}
NODE = 1  # as in the DBC
FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


def by_dbc(firmware: Firmware, name: str, **signals) -> CanFrame:
    message = DBC[firmware].get_message_by_name(name)
    return CanFrame(message.frame_id, message.encode(signals))


def test_ids_and_a_heartbeat_of_the_manual():
    """ODrive documentation, "CAN Frame": axis 1 and command 0x0C make 0x2C."""
    assert odrive.encode_command(1, 0x0C).can_id == 0x2C
    assert odrive.encode_input_torque(1, 0.0).can_id == 0x2E
    assert odrive.encode_command(63, OdriveCommand.TORQUES).can_id == 0x7FC
    # From the odrive-can project's documentation (0.5.6): an axis that is homing, with an invalid state.
    beat = odrive.decode_heartbeat(CanFrame(1, bytes.fromhex("010000000b000000")), Firmware.V0_5)
    assert axis_error_names(beat.axis_error, Firmware.V0_5) == ("INVALID_STATE",)
    assert beat.state is AxisState.HOMING
    assert not beat.component_errors


@pytest.mark.parametrize(
    ("firmware", "error", "state", "more", "names", "parts"),
    [
        (
            *(Firmware.V0_5, 0x840, AxisState.IDLE),
            {"Motor_Error_Flag": 1, "Encoder_Error_Flag": 0, "Controller_Error_Flag": 1},
            *(("MOTOR_FAILED", "WATCHDOG_TIMER_EXPIRED"), ("motor", "controller")),
        ),
        (
            *(Firmware.V0_6, 0x01000000, AxisState.CLOSED_LOOP_CONTROL, {"Procedure_Result": 3}),
            *(("WATCHDOG_TIMER_EXPIRED",), ()),
        ),
    ],
)
def test_heartbeat_matches_the_dbc(firmware, error, state, more, names, parts):
    signals = {"Axis_Error": error, "Axis_State": int(state), "Trajectory_Done_Flag": 1} | more
    beat = odrive.decode_heartbeat(by_dbc(firmware, "Heartbeat", **signals), firmware)
    assert axis_error_names(beat.axis_error, firmware) == names
    assert beat.state is state
    assert beat.component_errors == parts


def test_unnamed_error_bit_is_shown_as_a_number():
    assert axis_error_names(0x80, Firmware.V0_6) == ("unknown bit 0x00000080",)


@given(FLOATS, FLOATS)
def test_measurements_match_the_dbc(first, second):
    cases = (
        (Firmware.V0_6, "Encoder_Estimates", ("Pos_Estimate", "Vel_Estimate")),
        (Firmware.V0_5, "Iq", ("Iq_Setpoint", "Iq_Measured")),
        (Firmware.V0_6, "Torques", ("Torque_Target", "Torque_Estimate")),
        (Firmware.V0_5, "Bus_Voltage_Current", ("Bus_Voltage", "Bus_Current")),
    )
    for firmware, name, signals in cases:
        frame = by_dbc(firmware, name, **dict(zip(signals, (first, second), strict=True)))
        assert odrive.decode_two_floats(frame, name) == (first, second)


@given(FLOATS)
def test_torque_command_matches_the_dbc(torque_nm):
    frame = odrive.encode_input_torque(NODE, torque_nm)
    message = DBC[Firmware.V0_6].get_message_by_frame_id(frame.can_id)
    assert message.name == "Set_Input_Torque"
    assert message.decode(frame.data) == {"Input_Torque": torque_nm}


def test_other_commands_match_the_dbc():
    database = DBC[Firmware.V0_6]
    state = odrive.encode_command(NODE, OdriveCommand.SET_AXIS_STATE, AxisState.CLOSED_LOOP_CONTROL)
    assert database.decode_message(state.can_id, state.data) == {"Axis_Requested_State": 8}
    modes = odrive.TORQUE_CONTROL, odrive.PASSTHROUGH
    mode = odrive.encode_command(NODE, OdriveCommand.SET_CONTROLLER_MODE, *modes)
    assert database.decode_message(mode.can_id, mode.data) == {"Control_Mode": 1, "Input_Mode": 1}
    limits = odrive.encode_command(NODE, OdriveCommand.SET_LIMITS, 12.5, 40.0)
    limit = {"Velocity_Limit": 12.5, "Current_Limit": 40}
    assert database.decode_message(limits.can_id, limits.data) == limit
    assert odrive.encode_command(NODE, OdriveCommand.GET_VERSION) == CanFrame(0x20, b"", remote=True)


@pytest.mark.parametrize("length", [0, 4, 7])
@pytest.mark.parametrize(
    "decode",
    [
        lambda frame: odrive.decode_heartbeat(frame, Firmware.V0_5),
        lambda frame: odrive.decode_heartbeat(frame, Firmware.V0_6),
        lambda frame: odrive.decode_two_floats(frame, "encoder estimates"),
        odrive.decode_version,
    ],
)
def test_wrong_length_is_refused(decode, length):
    with pytest.raises(ProtocolError, match=f"{length} bytes, expected 8"):
        decode(CanFrame(0x21, bytes(length)))


def test_invalid_values_are_refused():
    with pytest.raises(ProtocolError, match="state 5 "):
        odrive.decode_heartbeat(CanFrame(0x21, bytes((0, 0, 0, 0, 5, 0, 0, 0))), Firmware.V0_6)
    with pytest.raises(ProtocolError, match="finite"):
        odrive.decode_two_floats(CanFrame(0x29, bytes.fromhex("0000c07f00000000")), "encoder estimates")
    for torque_nm in (float("nan"), float("inf"), 1e39):
        with pytest.raises(InputError):
            odrive.encode_input_torque(NODE, torque_nm)
