"""Random byte losses and flips: no driver serves a wrong number as OK."""

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
CAN = ("odrive", "mit", "damiao", "robstride", "moteus")  # CORRUPT cuts: a frame that lost a byte is none
CAN_RAD, SERVO_RAD = 1e-3, 0.01  # frames on CAN are dated by the sample, servos' answers by the tick [rad]
TOO_OLD_TICKS = 3  # how much older than a sample its stated time may be after losses
JUMP_N = 1.0  # 1 % of the capacity: smaller jumps are served, as not every protocol has checksums [N]
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
        self._trusted_s = []

    def note(self):
        plant = self._arm.arm.plant
        truth = plant.world.truth()
        self._times_s.append(truth.time_s)
        self._values.append(truth.joint_position_rad if self._bus == "motors" else plant.force[:1])

    def _since(self, at_s):
        """What was true since a time, a row for each joint; the first column is at that time."""
        later = bisect_left(self._times_s, at_s)
        first = max(later - 2, 0)
        rows = np.transpose(self._values[first:])
        return np.array(
            [[np.interp(at_s, self._times_s[first:], row), *row[later - first :]] for row in rows]
        )

    def radians_off(self, measurement):
        """By how much positions are off what was true.

        A measurement has the time of its oldest sample: after a lost frame, other joints are newer. Answers
        of CAN motors do not say what they answer, so that after losses their stated times may be too old, but
        never too new. So each value must have been true since the stated time, and one of them soon after it.
        """
        values, true = measurement.joint_position_rad, self._since(measurement.encoder_at_s)
        outside = np.maximum(values - true.max(axis=1), true.min(axis=1) - values)
        return max(*outside, np.min(np.abs(values - true[:, : TOO_OLD_TICKS + 1].T)))

    def newtons_off(self, measurement):
        """By how much a force is off what was true, beyond its change since the last trusted sample."""
        at_s = measurement.force_at_s
        self._trusted_s = [*self._trusted_s, at_s][-2:] if at_s not in self._trusted_s else self._trusted_s
        before_n, true_n = (self._since(time_s)[0, 0] for time_s in (self._trusted_s[0], at_s))
        return abs(measurement.force_n - true_n) - abs(true_n - before_n)


def move(arm, bus, tick):
    """The arm falls as it likes; the surface presses the sensor with 5 to 55 N."""
    world = arm.arm.plant.world
    world.held = bus == "load_cell"
    if world.held:
        depth_m = (30.0 + 25.0 * np.sin(tick / 40.0)) / world.object.law.stiffness_n_m
        world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)


def test_unpadded_lines_are_no_exception(make_robot, monkeypatch):
    """What is left of one that was cut is a number, and as long as others."""
    monkeypatch.setattr(EmulatedLoadstar, "width", 0)
    test_no_wrong_number_is_served_as_ok(make_robot, "loadstar", (), FaultKind.LOSE)


@pytest.mark.parametrize(
    ("family", "changes", "kind"), CASES, ids=[f"{c[0]}-{c[2]}-{len(c[1])}" for c in CASES]
)
def test_no_wrong_number_is_served_as_ok(make_robot, family, changes, kind):
    devices = FAMILIES[family]
    arm = make_robot(devices.robot, (*devices.changes, *changes))
    bus = devices.bus
    course, faults = Course(arm, bus), arm.faults[bus]
    faults.generator = np.random.default_rng(1)
    arm.robot.configure()
    if bus == "motors":
        arm.robot.activate()
    trusted = sound = 0
    for tick in range(TICKS):
        sound += sum(faults._occurrences.values()) == DAMAGED
        if sound > AFTER:
            break
        if tick == FIRST_TICK:
            arm.inject_fault(bus, kind, times=DAMAGED, probability=SHARE)
        move(arm, bus, tick)
        arm.clock.sleep_until(arm.clock.now_s() + arm.period_s)
        course.note()
        measurement = arm.robot.read(arm.clock.now_s() + READ_SHARE * arm.period_s)
        status = measurement.encoder_status if bus == "motors" else measurement.force_status
        if tick > 20 and status is Status.OK:
            trusted += 1
            if bus == "load_cell":
                assert course.newtons_off(measurement) < JUMP_N, tick
            else:
                assert course.radians_off(measurement) < (CAN_RAD if family in CAN else SERVO_RAD), tick
    assert sum(faults._occurrences.values()) == DAMAGED
    assert trusted > 30  # what is damaged so often is rightly doubted for long
