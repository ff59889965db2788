"""Bytes are lost and flipped at random places: no wrong number is served as OK, by any driver."""

from bisect import bisect_left

import numpy as np
import pytest
from hypothesis import settings

from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from palpate.sim_backend.emulators.serial_sensors import EmulatedLoadstar
from tests.wire.fault_matrix.rows import FAMILIES
from tests.wire.parts import READ_SHARE

# Frames that are damaged, their share of all, the tick of the first, most ticks, and ticks after the last.
DAMAGED, SHARE, FIRST_TICK, TICKS, AFTER = (15, 0.08, 40, 1300, 40)
if settings.default.max_examples >= 100:  # in `make test-all`
    DAMAGED, SHARE, FIRST_TICK, TICKS, AFTER = (25, 0.04, 60, 2600, 60)
TOLERANCES = {"motors": 0.02, "load_cell": 2.0}  # [rad], [N]: 1 % of the capacity, and what it moves
CAN = ("odrive", "mit", "damiao", "robstride", "moteus")  # CORRUPT cuts: a frame that lost a byte is none
PLAIN = (("fast_sync_read: true", "fast_sync_read: false"),)
CASES = [
    *((family, (), FaultKind.CORRUPT) for family in FAMILIES),
    *((family, (), FaultKind.LOSE) for family in FAMILIES if family not in CAN),
    ("dynamixel", PLAIN, FaultKind.CORRUPT),
    ("dynamixel", PLAIN, FaultKind.LOSE),
]


class Course:
    """What was true, tick by tick, for a sample of any age to be held against."""

    def __init__(self, arm, bus):
        self._arm, self._bus = arm, bus
        self._times_s, self._values = [], []

    def note(self):
        plant = self._arm.arm.plant
        truth = plant.world.truth()
        self._times_s.append(truth.time_s)
        self._values.append(truth.joint_position_rad if self._bus == "motors" else plant.force[:1])

    def off_by(self, measurement):
        """By how much a sample is off what was true when it says that it was taken."""
        value, at_s = measurement.joint_position_rad, measurement.encoder_at_s
        if self._bus == "load_cell":
            value, at_s = [measurement.force_n], measurement.force_at_s
        later = bisect_left(self._times_s, at_s)
        near = slice(max(later - 2, 0), later + 2)
        columns = np.transpose(self._values[near])
        return max(
            abs(one - np.interp(at_s, self._times_s[near], true))
            for one, true in zip(value, columns, strict=True)
        )


def move(arm, bus, tick):
    """The arm falls as it likes; the surface presses the sensor with 5 to 55 N."""
    world = arm.arm.plant.world
    world.held = bus == "load_cell"
    if world.held:
        depth_m = (30.0 + 25.0 * np.sin(tick / 40.0)) / world.object.law.stiffness_n_m
        world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)


def test_lines_that_nothing_pads_are_no_exception(bench, monkeypatch):
    """What is left of one that was cut is a number, and as long as others."""
    monkeypatch.setattr(EmulatedLoadstar, "width", 0)
    test_no_wrong_number_is_served_as_ok(bench, "loadstar", (), FaultKind.LOSE)


@pytest.mark.parametrize(
    ("family", "changes", "kind"), CASES, ids=[f"{c[0]}-{c[2]}-{len(c[1])}" for c in CASES]
)
def test_no_wrong_number_is_served_as_ok(bench, family, changes, kind):
    devices = FAMILIES[family]
    arm = bench(devices.robot, (*devices.changes, *changes))
    bus = devices.bus
    course, faults = Course(arm, bus), arm.faults[bus]
    faults.generator = np.random.default_rng(1)
    arm.robot.configure()
    if bus == "motors":
        arm.robot.activate()
    trusted = sound = 0
    for tick in range(TICKS):
        sound += sum(faults._struck.values()) == DAMAGED
        if sound > AFTER:
            break
        if tick == FIRST_TICK:
            arm.strike(bus, kind, times=DAMAGED, probability=SHARE)
        move(arm, bus, tick)
        arm.clock.sleep_until(arm.clock.now_s() + arm.period_s)
        course.note()
        measurement = arm.robot.read(arm.clock.now_s() + READ_SHARE * arm.period_s)
        status = measurement.encoder_status if bus == "motors" else measurement.force_status
        if tick > 20 and status is Status.OK:
            trusted += 1
            assert course.off_by(measurement) < TOLERANCES[bus], tick
    assert sum(faults._struck.values()) == DAMAGED
    assert trusted > 30  # what is damaged so often is rightly doubted for long
