"""Numbers of ODrive's CANSimple protocol.

Sources: ODrive documentation "CAN Protocol" for firmware 0.5.6 (with its table can-protocol.csv) and 0.6.10
(docs.odriverobotics.com), the enumerations in odriverobotics/ros_odrive (odrive_enums.h, firmware 0.6), and
the axis errors of odriverobotics/ODrive fw-v0.5.6.
"""

from enum import IntEnum, StrEnum


class Firmware(StrEnum):
    """Generations that differ on the bus: heartbeat layout, error bits, and what reports the torque."""

    V0_5 = "0.5"
    V0_6 = "0.6"


class OdriveCommand(IntEnum):
    """The five lower bits of the arbitration id."""

    GET_VERSION = 0x00  # 0.6 only; in 0.5 this id belongs to CANopen
    HEARTBEAT = 0x01
    SET_AXIS_STATE = 0x07
    ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_TORQUE = 0x0E
    GET_IQ = 0x14
    BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18
    TORQUES = 0x1C  # 0.6 only


# An axis as shipped does not run below (dc_bus_undervoltage_trip_level of fw-v0.5.6).
UNDERVOLTAGE_V = 8.0


class AxisState(IntEnum):
    """What an axis is doing; the same numbers in both generations."""

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
    """Names of the bits that are set in an axis error; a bit without a name is given as a number."""
    table = AXIS_ERRORS[firmware]
    bits = (1 << place for place in range(32) if error >> place & 1)
    return tuple(table.get(bit, f"unknown bit 0x{bit:08X}") for bit in bits)
