"""Driver constants against the manuals and the emulators."""

import pytest

from palpate.robot_io.drivers import moteus
from palpate.robot_io.drivers.dynamixel import tables as dynamixel
from palpate.robot_io.drivers.feetech import tables as feetech
from palpate.robot_io.drivers.feetech.protocol import error_names
from palpate.robot_io.drivers.mit.settings import DIALECTS, Maker
from palpate.robot_io.drivers.odrive_protocol import AXIS_ERRORS, WATCHDOG_EXPIRED, AxisState, Firmware
from palpate.robot_io.drivers.servo.line import Register
from palpate.sim_backend.emulators import feetech as emulated_sts
from palpate.sim_backend.emulators.dynamixel_servo import MODELS, control_table

DYNAMIXEL = """
9 return delay time 1, 10 drive mode 1, 11 operating mode 1, 12 secondary id 1, 20 homing offset -4,
31 temperature limit 1, 32 max voltage limit 2, 34 min voltage limit 2, 38 current limit 2,
64 torque enable 1, 68 status return level 1, 70 hardware error status 1,
98 bus watchdog -1, 102 goal current -2, 126 present current -2, 128 present velocity -4,
132 present position -4, 144 present input voltage 2, 146 present temperature 1
"""  # address, name, bytes (minus: signed)
FEETECH = """
0 firmware version 2, 3 model number 2, 7 return delay time 1, 8 response status level 1,
9 min position limit 2, 11 max position limit 2, 13 max temperature limit 1,
14 max voltage limit 1, 15 min voltage limit 1, 18 phase 1,
21 P coefficient 1, 22 D coefficient 1, 23 I coefficient 1, 24 minimum startup force 2, 26 CW dead zone 1,
27 CCW dead zone 1, 31 homing offset 2/11, 33 operating mode 1, 40 torque enable 1, 41 acceleration 1,
42 goal position 2/15, 44 goal time 2, 46 goal speed 2, 48 torque limit 2, 55 lock 1,
56 present position 2/15, 58 present speed 2/15, 60 present load 2/10, 62 present voltage 1,
63 present temperature 1, 65 status 1
"""  # bytes/sign bit


def stated(text):
    """Registers by name."""
    found = {}
    for entry in text.replace("\n", " ").split(","):
        address, *name, form = entry.split()
        size, _, sign_bit = form.partition("/")
        sign = int(sign_bit) if sign_bit else None
        found[" ".join(name)] = Register(" ".join(name), int(address), abs(int(size)), int(size) < 0, sign)
    return found


@pytest.mark.parametrize(("tables", "text"), [(dynamixel, DYNAMIXEL), (feetech, FEETECH)])
def test_register_addresses_match_the_manual(tables, text):
    known = [one for one in vars(tables).values() if isinstance(one, Register)]
    assert {one.name: one for one in known} == stated(text)


@pytest.mark.parametrize("name", dynamixel.MODELS)
def test_dynamixel_matches_its_emulator(name):
    ours, theirs = dynamixel.MODELS[name], MODELS[name]
    assert (ours.number, ours.current_step_a, ours.largest_current, ours.indirect_data) == (
        *(theirs.number, theirs.current_unit_a, theirs.current_limit, theirs.indirect_data),
    )
    assert ours.torque_constant_nm_a == theirs.torque_per_ampere_nm
    assert ours.fast_sync_read_firmware == (46 if "330" in name else 45)
    rows = control_table(theirs, 1, 45)
    registers = [one for one in vars(dynamixel).values() if isinstance(one, Register)]
    assert all(rows[one.address].size == one.size for one in registers)
    assert dynamixel.ServoSettings.name_model(theirs.number) == name


def test_dynamixel_numbers_have_documented_units():
    assert list(dynamixel.DRIVE_MODE_PROBLEMS) == [0x01, 0x02, 0x08]  # 0x04 is a profile by time
    assert pytest.approx(0.0239808, rel=1e-5) == dynamixel.VELOCITY_STEP_RAD_S  # 0.229 rpm
    assert pytest.approx(0.00153398, rel=1e-5) == dynamixel.POSITION_STEP_RAD  # 0.088 degrees


@pytest.mark.parametrize("name", feetech.MODELS)
def test_feetech_servo_matches_its_emulator(name):
    ours = feetech.MODELS[name]
    assert (ours.voltage_v, ours.stall_torque_nm, ours.no_load_rad_s) == pytest.approx(
        emulated_sts.MODELS[name]
    )
    assert name in feetech.FeetechServo.name_model(777)


AXIS_ERROR_BITS = {
    Firmware.V0_5: """0 INVALID_STATE, 6 MOTOR_FAILED, 7 SENSORLESS_ESTIMATOR_FAILED, 8 ENCODER_FAILED,
    9 CONTROLLER_FAILED, 11 WATCHDOG_TIMER_EXPIRED, 12 MIN_ENDSTOP_PRESSED, 13 MAX_ENDSTOP_PRESSED,
    14 ESTOP_REQUESTED, 17 HOMING_WITHOUT_ENDSTOP, 18 OVER_TEMP, 19 UNKNOWN_POSITION""",
    Firmware.V0_6: """0 INITIALIZING, 1 SYSTEM_LEVEL, 2 TIMING_ERROR, 3 MISSING_ESTIMATE, 4 BAD_CONFIG,
    5 DRV_FAULT, 6 MISSING_INPUT, 8 DC_BUS_OVER_VOLTAGE, 9 DC_BUS_UNDER_VOLTAGE, 10 DC_BUS_OVER_CURRENT,
    11 DC_BUS_OVER_REGEN_CURRENT, 12 CURRENT_LIMIT_VIOLATION, 13 MOTOR_OVER_TEMP, 14 INVERTER_OVER_TEMP,
    15 VELOCITY_LIMIT_VIOLATION, 16 POSITION_LIMIT_VIOLATION, 24 WATCHDOG_TIMER_EXPIRED, 25 ESTOP_REQUESTED,
    26 SPINOUT_DETECTED, 27 BRAKE_RESISTOR_DISARMED, 28 THERMISTOR_DISCONNECTED, 30 CALIBRATION_ERROR""",
}


@pytest.mark.parametrize("firmware", Firmware)
def test_odrive_error_bits_match_its_firmware(firmware):
    entries = (entry.split() for entry in AXIS_ERROR_BITS[firmware].split(","))
    assert {1 << int(bit): name for bit, name in entries} == AXIS_ERRORS[firmware]
    assert AXIS_ERRORS[firmware][WATCHDOG_EXPIRED[firmware]] == "WATCHDOG_TIMER_EXPIRED"


def test_odrive_states_match_its_manual():
    names = (
        "UNDEFINED IDLE STARTUP_SEQUENCE FULL_CALIBRATION_SEQUENCE MOTOR_CALIBRATION (none) "
        "ENCODER_INDEX_SEARCH ENCODER_OFFSET_CALIBRATION CLOSED_LOOP_CONTROL LOCKIN_SPIN ENCODER_DIR_FIND "
        "HOMING ENCODER_HALL_POLARITY_CALIBRATION ENCODER_HALL_PHASE_CALIBRATION ANTICOGGING_CALIBRATION"
    )
    numbered = {number: name for number, name in enumerate(names.split()) if number != 5}
    assert {int(state): state.name for state in AxisState} == numbered


@pytest.mark.parametrize(
    ("maker", "first", "names", "encoder", "timeout"),
    [
        (
            *(Maker.CUBEMARS, 1),
            "motor over temperature, over current, over voltage, under voltage, encoder fault, "
            "MOSFET over temperature, motor stalled",
            *("encoder fault", None),
        ),
        (
            *(Maker.DAMIAO, 8),
            "over voltage, under voltage, over current, MOSFET over temperature, motor over temperature, "
            "lost communication: its CAN timeout has fired, overload",
            *(None, "lost communication: its CAN timeout has fired"),
        ),
    ],
)
def test_mit_motor_errors_match_its_manual(maker, first, names, encoder, timeout):
    dialect = DIALECTS[maker]
    assert dialect.errors == dict(enumerate(names.split(", "), first))
    assert encoder == (dialect.encoder_fault and dialect.error_names(dialect.encoder_fault))
    assert timeout == (dialect.timeout_error and dialect.error_names(dialect.timeout_error))


@pytest.mark.parametrize(
    ("names_of", "bits"),
    [
        (
            dynamixel.hardware_error_names,
            {0: "input voltage", 2: "overheating", 3: "motor encoder", 4: "electrical shock", 5: "overload"},
        ),
        (
            error_names,
            {0: "input voltage", 1: "position sensor", 2: "overheating", 3: "over current", 5: "overload"},
        ),
    ],
)
def test_servo_error_bits_match_its_manual(names_of, bits):
    assert {bit: names_of(1 << bit) for bit in range(8) if "unknown" not in names_of(1 << bit)} == bits


MOTEUS_CODES = """32 calibration fault, 33 motor driver fault, 34 over voltage, 35 encoder fault,
36 motor not configured, 37 PWM cycle overrun, 38 over temperature, 40 under voltage,
41 configuration changed, 42 no valid commutation encoder, 43 no valid output encoder, 44 driver enable fault,
45 stop position deprecated, 46 timing violation, 48 invalid limits,
96 servo.max_velocity, 97 servo.max_power_W, 98 the supply voltage, 99 servo.max_current_A,
100 servo.fault_temperature, 101 servo.motor_fault_temperature, 102 the commanded maximum torque,
103 servopos.position_min or position_max"""


def test_moteus_codes_match_its_manual():
    entries = (entry.split(maxsplit=1) for entry in MOTEUS_CODES.split(","))
    known = moteus.FAULTS | moteus.LIMITS
    assert all(known[int(code)] == name.strip() for code, name in entries)
    assert "position_min" in known[39]
    assert {code for code, name in known.items() if " encoder" in f" {name}"} == moteus.ENCODER_FAULTS
    assert min(moteus.LIMITS) == moteus.FIRST_LIMIT
