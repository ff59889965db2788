"""ODrive CANSimple: ids, frames to an axis, and messages from it; little-endian, in motor revolutions.

Sources: ODrive documentation "CAN Protocol" for firmware 0.5.6 (with its table can-protocol.csv) and 0.6.10
(docs.odriverobotics.com), the enumerations in odriverobotics/ros_odrive (odrive_enums.h, firmware 0.6), and
the axis errors of odriverobotics/ODrive fw-v0.5.6.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from math import isfinite

from palpate.robot_io.drivers.can.line import CanFrame, expect_length
from palpate.robot_io.errors import InputError, ProtocolError


class Firmware(StrEnum):
    """Firmware generations, which differ in heartbeat layout, error bits and torque message."""

    V0_5 = "0.5"
    V0_6 = "0.6"


class OdriveCommand(IntEnum):
    """The five lower bits of the arbitration id."""

    GET_VERSION = 0x00  # 0.6 only; in 0.5 this id belongs to CANopen
    HEARTBEAT = 0x01
    SET_AXIS_STATE = 0x07
    ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_VELOCITY = 0x0D
    SET_INPUT_TORQUE = 0x0E
    SET_LIMITS = 0x0F
    GET_IQ = 0x14
    BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18
    TORQUES = 0x1C  # 0.6 only


# Names in odrivetool of settings that only USB can reach.
# Periods [ms] of heartbeat, encoder estimates and torques (0.5: currents); as delivered 100, 10 and 0 (none).
PERIOD_SETTINGS = {
    Firmware.V0_5: tuple(f"odrv0.axis0.config.can.{name}_rate_ms" for name in ("heartbeat", "encoder", "iq")),
    Firmware.V0_6: tuple(
        f"odrv0.axis0.config.can.{name}_msg_rate_ms" for name in ("heartbeat", "encoder", "torques")
    ),
}
# Period of Get_Bus_Voltage_Current [ms]; as delivered 0 (only on request).
VOLTAGE_PERIOD = {
    Firmware.V0_5: "odrv0.axis0.config.can.bus_vi_rate_ms",
    Firmware.V0_6: "odrv0.axis0.config.can.bus_voltage_msg_rate_ms",
}
# As delivered, it limits torques in torque mode to (2 rev/s - speed) * 0.17 N m s/rev.
ENABLE_VELOCITY_LIMIT = "odrv0.axis0.controller.config.enable_torque_mode_vel_limit"
VELOCITY_LIMIT = "odrv0.axis0.controller.config.vel_limit"  # [rev/s]
WATCHDOG_TIMEOUT = "odrv0.axis0.config.watchdog_timeout"  # [s]
ENABLE_WATCHDOG = "odrv0.axis0.config.enable_watchdog"
CURRENT_LIMIT = {  # [A]
    Firmware.V0_5: "odrv0.axis0.motor.config.current_lim",
    Firmware.V0_6: "odrv0.axis0.config.motor.current_soft_max",
}

# Default supply voltage below which an axis does not run (dc_bus_undervoltage_trip_level of fw-v0.5.6).
UNDERVOLTAGE_V = 8.0


class AxisState(IntEnum):
    """State of an axis; the numbers are the same in both generations."""

    UNDEFINED = 0
    IDLE = 1
    STARTUP_SEQUENCE = 2
    FULL_CALIBRATION_SEQUENCE = 3
    MOTOR_CALIBRATION = 4
    ENCODER_INDEX_SEARCH = 6
    ENCODER_OFFSET_CALIBRATION = 7
    CLOSED_LOOP_CONTROL = 8
    LOCKIN_SPIN = 9
    ENCODER_DIR_FIND = 10
    HOMING = 11
    ENCODER_HALL_POLARITY_CALIBRATION = 12
    ENCODER_HALL_PHASE_CALIBRATION = 13
    ANTICOGGING_CALIBRATION = 14


TORQUE_CONTROL = 1  # control_mode
PASSTHROUGH = 1  # input_mode

MAX_NODE_ID = 0x3F
COMMAND_BITS = 5

AXIS_ERRORS: dict[Firmware, dict[int, str]] = {
    Firmware.V0_5: {
        0x00000001: "INVALID_STATE",
        0x00000040: "MOTOR_FAILED",
        0x00000080: "SENSORLESS_ESTIMATOR_FAILED",
        0x00000100: "ENCODER_FAILED",
        0x00000200: "CONTROLLER_FAILED",
        0x00000800: "WATCHDOG_TIMER_EXPIRED",
        0x00001000: "MIN_ENDSTOP_PRESSED",
        0x00002000: "MAX_ENDSTOP_PRESSED",
        0x00004000: "ESTOP_REQUESTED",
        0x00020000: "HOMING_WITHOUT_ENDSTOP",
        0x00040000: "OVER_TEMP",
        0x00080000: "UNKNOWN_POSITION",
    },
    Firmware.V0_6: {
        0x00000001: "INITIALIZING",
        0x00000002: "SYSTEM_LEVEL",
        0x00000004: "TIMING_ERROR",
        0x00000008: "MISSING_ESTIMATE",
        0x00000010: "BAD_CONFIG",
        0x00000020: "DRV_FAULT",
        0x00000040: "MISSING_INPUT",
        0x00000100: "DC_BUS_OVER_VOLTAGE",
        0x00000200: "DC_BUS_UNDER_VOLTAGE",
        0x00000400: "DC_BUS_OVER_CURRENT",
        0x00000800: "DC_BUS_OVER_REGEN_CURRENT",
        0x00001000: "CURRENT_LIMIT_VIOLATION",
        0x00002000: "MOTOR_OVER_TEMP",
        0x00004000: "INVERTER_OVER_TEMP",
        0x00008000: "VELOCITY_LIMIT_VIOLATION",
        0x00010000: "POSITION_LIMIT_VIOLATION",
        0x01000000: "WATCHDOG_TIMER_EXPIRED",
        0x02000000: "ESTOP_REQUESTED",
        0x04000000: "SPINOUT_DETECTED",
        0x08000000: "BRAKE_RESISTOR_DISARMED",
        0x10000000: "THERMISTOR_DISCONNECTED",
        0x40000000: "CALIBRATION_ERROR",
    },
}

WATCHDOG_EXPIRED = {Firmware.V0_5: 0x00000800, Firmware.V0_6: 0x01000000}


def axis_error_names(error: int, firmware: Firmware) -> tuple[str, ...]:
    """Name the bits that are set in an axis error; a bit without a name is named by its number.

    Args:
        error: error bits of an axis.
        firmware: generation of the axis.
    """
    table = AXIS_ERRORS[firmware]
    bits = (1 << place for place in range(32) if error >> place & 1)
    return tuple(table.get(bit, f"unknown bit 0x{bit:08X}") for bit in bits)


_FLOAT = struct.Struct("<f")
_TWO_FLOATS = struct.Struct("<ff")
_WORD = struct.Struct("<I")
_TWO_WORDS = struct.Struct("<II")
_LAYOUTS = {
    OdriveCommand.SET_AXIS_STATE: _WORD,
    OdriveCommand.SET_CONTROLLER_MODE: _TWO_WORDS,
    OdriveCommand.SET_INPUT_VELOCITY: _TWO_FLOATS,
    OdriveCommand.SET_LIMITS: _TWO_FLOATS,
    OdriveCommand.CLEAR_ERRORS: struct.Struct("<B"),
}


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """State that an axis reports without a request."""

    axis_error: int  # error bits, see `axis_error_names`
    state: AxisState  # state of the axis
    component_errors: tuple[str, ...] = ()  # names of the components that report an error (0.5 only)


def decode_heartbeat(frame: CanFrame, firmware: Firmware) -> Heartbeat:
    """Decode a heartbeat of either generation; raise `ProtocolError` for a wrong length or state.

    Bytes 0 to 3 are the axis error and byte 4 the state. Then 0.5 has flags for motor, encoder and
    controller, and 0.6 has the results of procedures and trajectories, which are not used.

    Args:
        frame: received frame.
        firmware: generation of the axis.
    """
    expect_length(frame, "heartbeat", 8)
    data = frame.data
    (axis_error,) = _WORD.unpack_from(data)
    try:
        state = AxisState(data[4])
    except ValueError as error:
        raise ProtocolError(f"heartbeat: axis state {data[4]} does not exist") from error
    if firmware is Firmware.V0_6:
        return Heartbeat(axis_error, state)
    flags = (("motor", data[5] & 1), ("encoder", data[6] & 1), ("controller", data[7] & 1))
    return Heartbeat(axis_error, state, tuple(part for part, flag in flags if flag))


def decode_two_floats(frame: CanFrame, what: str) -> tuple[float, float]:
    """Decode two floats, such as position [rev] and velocity [rev/s], or desired and measured current [A].

    Args:
        frame: received frame.
        what: name of its content in errors.

    Raises:
        ProtocolError: wrong length, or not finite.
    """
    expect_length(frame, what, 8)
    first, second = _TWO_FLOATS.unpack(frame.data)
    if not (isfinite(first) and isfinite(second)):
        raise ProtocolError(f"{what}: {first} and {second} are not both finite")
    return first, second


def decode_version(frame: CanFrame) -> tuple[int, int, int]:
    """Decode major, minor and revision number of the firmware (0.6); raise `ProtocolError` if not 8 bytes.

    Args:
        frame: received frame.
    """
    expect_length(frame, "version", 8)
    return frame.data[4], frame.data[5], frame.data[6]


def encode_command(node_id: int, command: OdriveCommand, *values: float) -> CanFrame:
    """Make the frame of a command, or the remote frame that requests a message.

    Args:
        node_id: node id of the axis, 0 to 63.
        command: command, or message to request.
        values: values of the command. `SET_AXIS_STATE` takes the state, `SET_CONTROLLER_MODE` control and
            input mode. `SET_INPUT_VELOCITY` takes velocity [rev/s] and torque [N m] of the motor; in torque
            control, only the torque has an effect. `SET_LIMITS` takes the velocity [rev/s] above which the
            axis fails, and the current [A]; the axis loses both at its next start, and CANSimple cannot read
            them. `CLEAR_ERRORS` takes 0, so that the identify light stays as it is.
    """
    layout = _LAYOUTS.get(command)
    data = b"" if layout is None else layout.pack(*values)
    return CanFrame(node_id << COMMAND_BITS | command, data, remote=layout is None)


def encode_input_torque(node_id: int, torque_nm: float) -> CanFrame:
    """Command a motor torque [N m], which feeds the watchdog; raise `InputError` if not a 32 bit float.

    Args:
        node_id: node id of the axis.
        torque_nm: torque of the motor [N m].
    """
    try:
        data = _FLOAT.pack(torque_nm)
    except OverflowError as error:
        raise InputError(f"torque {torque_nm} N m does not fit into 32 bits") from error
    if not isfinite(torque_nm):
        raise InputError(f"torque {torque_nm} N m is not finite")
    return CanFrame(node_id << COMMAND_BITS | OdriveCommand.SET_INPUT_TORQUE, data)
