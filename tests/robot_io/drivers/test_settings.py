"""Device settings of a robot file: bounds and defaults."""

from math import pi

import pytest
from pydantic import TypeAdapter, ValidationError

from palpate.robot_io.drivers.can.line import CanLineSettings
from palpate.robot_io.drivers.can.motors import MotorMounting
from palpate.robot_io.drivers.dynamixel.tables import DynamixelSettings, ServoSettings
from palpate.robot_io.drivers.feetech.lerobot import LerobotMotor
from palpate.robot_io.drivers.feetech.tables import FeetechServo, FeetechSettings
from palpate.robot_io.drivers.mit.settings import MitBusSettings, MitMotor, MitRangeSettings
from palpate.robot_io.drivers.moteus import MoteusMotor
from palpate.robot_io.drivers.net_ft import NetFtLineSettings
from palpate.robot_io.drivers.odrive import OdriveAxis, OdriveBusSettings
from palpate.robot_io.drivers.serial_force.bota import BotaSettings
from palpate.robot_io.drivers.serial_force.gauges import ForceLinesSettings, LoadstarSettings, Mark10Settings
from palpate.robot_io.drivers.serial_force.line import AxisForceSettings, SerialLineSettings
from palpate.robot_io.drivers.serial_force.lorenz import LorenzSettings
from palpate.robot_io.drivers.serial_force.microcontroller_cell import MicrocontrollerCellSettings
from palpate.robot_io.drivers.servo.joints import ServoBusSettings, ServoMounting

AMPERES = (ServoSettings, OdriveAxis)
CAPABLE = (
    *(AxisForceSettings, ForceLinesSettings, LoadstarSettings),
    *(Mark10Settings, MicrocontrollerCellSettings),
)
EDGES = [  # first and last that is taken, just beyond them, and the value that may be left out
    (BotaSettings, "rate_hz", (100, 800), (50, 801), 800),
    (CanLineSettings, "bitrate", (1, 1_000_000), (0, 1_000_001), None),
    (DynamixelSettings, "baud_rate", (57_600, 4_500_000), (9_600, 5_000_000), 4_000_000),
    (DynamixelSettings, "return_delay_s", (0.0, 0.000508), (-1e-6, 0.00051), 0.0),
    (DynamixelSettings, "watchdog_s", (0.02, 2.54), (0.0199, 2.55), 0.06),
    (ServoSettings, "homing_offset", (-1_044_479, 1_044_479), (-1_044_480, 1_044_480), None),
    (FeetechServo, "homing_offset", (-2047, 2047), (-2048, 2048), None),
    (FeetechSettings, "baud_rate", (115_200, 1_000_000), (57_600, 2_000_000), 1_000_000),
    (FeetechSettings, "hold", ((0,), (252,)), ((-1,), (253,)), ()),
    (FeetechSettings, "p_gain", (1, 100), (0, 101), 16),
    (ForceLinesSettings, "pattern", ("x", "x" * 200), ("", "x" * 201), ...),
    (ForceLinesSettings, "scale", (1e-9, 1e9), (0.0, -1.0), 1.0),
    (ForceLinesSettings, "start", ("", "x" * 100), ("x" * 101,), ""),
    (LerobotMotor, "drive_mode", (0, 1), (-1, 2), ...),
    (LerobotMotor, "id", (0, 252), (-1, 253), ...),
    (LerobotMotor, "range_max", (0, 4095), (-1, 4096), ...),
    (LorenzSettings, "address", (1, 254), (0, 255), 1),
    (LorenzSettings, "counts_at_nominal", (1.0, 32_767.0), (0, 32_768), ...),
    (LorenzSettings, "dimension_code", (0, 255), (-1, 256), ...),
    (LorenzSettings, "load_code", (0, 65_535), (-1, 65_536), ...),
    (MicrocontrollerCellSettings, "rate_hz", (1, 1000), (0, 1001), ...),
    (MitBusSettings, "host_id", (0, 0x7FF), (-1, 0x800), None),
    (MitBusSettings, "watchdog_s", (1e-3, 1.0), (0.9e-3, 1.01), 0.1),
    (MitRangeSettings, "position_rad", (0.1, 1e4), (0.09, 1.1e4), ...),
    (MitRangeSettings, "torque_nm", (0.1, 1e4), (0.09, 1.1e4), ...),
    (MitRangeSettings, "velocity_rad_s", (0.1, 1e4), (0.09, 1.1e4), ...),
    (MitMotor, "answer_id", (1, 0x7FE), (0, 0x7FF), None),
    (MitMotor, "motor_id", (1, 255), (0, 256), ...),
    (MotorMounting, "gear_ratio", (1e-3, 1e4), (0.9e-3, 1.1e4, -1.0), 1.0),
    (NetFtLineSettings, "host", ("x", "x" * 253), ("", "x" * 254), ...),
    (NetFtLineSettings, "http_port", (1, 65_535), (0, 65_536), 80),
    (NetFtLineSettings, "rdt_port", (1, 65_535), (0, 65_536), 49_152),
    (OdriveAxis, "node_id", (0, 63), (-1, 64), ...),
    (OdriveBusSettings, "heartbeat_s", (1e-3, 1.0), (0.0, 1.01), 0.1),
    (OdriveBusSettings, "watchdog_s", (1e-3, 1.0), (0.0, 1.01), 0.1),
    (SerialLineSettings, "baud_rate", (1, 12_000_000), (0, 12_000_001), ...),
    (SerialLineSettings, "delay_s", (0.0, 1.0), (-0.1, 1.01), 0.0),
    (SerialLineSettings, "port", ("x", "x" * 300), ("", "x" * 301), ...),
    (ServoBusSettings, "pair_tolerance_rad", (1e-6, 0.5), (0.0, 0.51), 0.035),
    (ServoMounting, "id", (0, 252), (-1, 253), ...),
    (LorenzSettings, "nominal_load", (1e-3, 1e6), (0.0, 1.1e6), ...),
    *((model, "capacity_n", (1e-3, 1e5), (0.0, 1.1e5), ...) for model in CAPABLE),
    *((model, "max_torque_nm", (1e-3, 1e4), (0.0, 1.1e4), ...) for model in (OdriveAxis, MoteusMotor)),
    *((model, "torque_constant_nm_a", (1e-3, 100.0), (0.9e-3, 101.0), None) for model in AMPERES),
]


@pytest.mark.parametrize(("model", "key", "taken", "refused", "default"), EDGES, ids=str)
def test_impossible_number_is_refused(model, key, taken, refused, default):
    field = model.model_fields[key]
    adapter = TypeAdapter(field.rebuild_annotation())
    assert [adapter.validate_python(value) for value in taken] == list(taken)
    for value in refused:
        with pytest.raises(ValidationError):
            adapter.validate_python(value)
    assert field.is_required() if default is ... else field.default == default


@pytest.mark.parametrize(
    ("model", "key"), [(model, key) for model, key, taken, *_ in EDGES if type(taken[0]) is int]
)
def test_integer_setting_rejects_other_types(model, key):
    adapter = TypeAdapter(model.model_fields[key].rebuild_annotation())
    for value in (True, "100", 100.5):
        with pytest.raises(ValidationError):
            adapter.validate_python(value)


@pytest.mark.parametrize(
    ("model", "key", "default"),
    [
        *((model, "reversed", False) for model in (ForceLinesSettings, LoadstarSettings, LorenzSettings)),
        *(
            (MicrocontrollerCellSettings, "reversed", False),
            (MicrocontrollerCellSettings, "zero_counts", 0.0),
        ),
        *(
            (MotorMounting, "reversed", False),
            (MotorMounting, "zero_rad", 0.0),
            (ServoMounting, "zero_rad", pi),
        ),
        *((LorenzSettings, "rate_hz", 1000), (LoadstarSettings, "tare", False)),
        *((ServoMounting, "reversed", False), (DynamixelSettings, "fast_sync_read", True)),
    ],
)
def test_optional_settings_have_plain_defaults(model, key, default):
    assert model.model_fields[key].default == default
