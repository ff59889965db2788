"""Two servos on a joint: torques add, both must agree, and each keeps its own limits."""

import re
from math import pi

import numpy as np
import pytest

from palpate.robot_io.calibration.applied import device_identity
from palpate.robot_io.drivers.dynamixel.bus import count_steps
from palpate.robot_io.drivers.dynamixel.tables import DynamixelSettings
from palpate.robot_io.drivers.feetech.tables import FeetechSettings
from palpate.robot_io.drivers.servo.joints import ServoJoints, ServoPairs
from palpate.robot_io.errors import DeviceError, InputError
from palpate.robot_io.examination import Level
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from palpate.sim_backend.emulators import dynamixel_servo as table
from tests.wire.parts import DYNAMIXEL, DYNAMIXEL_PAIR, FEETECH_PAIR, SO101

FAMILIES = {"dynamixel": (DYNAMIXEL, DYNAMIXEL_PAIR, 4), "feetech": (SO101, FEETECH_PAIR, 7)}
DYNAMIXEL_STEP_NM, LIMIT = 0.00269 * 10.6 / 4.4, 48


@pytest.fixture(params=FAMILIES)
def family(request):
    return request.param


@pytest.fixture
def make(make_robot):
    return lambda family, *changes: make_robot(FAMILIES[family][0], (FAMILIES[family][1], *changes))


def shafts(arm):
    """Of the two on the first joint."""
    shaft = min(arm.servos.values(), key=lambda servo: servo.id if servo.shaft else 99).shaft
    return shaft, shaft.beside


def test_each_servo_exerts_half_and_both_are_one_joint(make, family):
    arm = make(family).start()
    arm.hold()
    wanted_nm = np.array([1.0, -0.4, 0.1])
    measurement = arm.ticks(3, wanted_nm)
    np.testing.assert_allclose(measurement.joint_torque_nm, wanted_nm, atol=0.03)
    assert [shaft.torque_nm for shaft in shafts(arm)] == pytest.approx([0.5, 0.5], abs=0.01)
    truth = arm.arm.plant.world.truth()
    np.testing.assert_allclose(measurement.joint_position_rad, truth.joint_position_rad, atol=0.01)
    assert measurement.joint_velocity_rad_s.shape == (3,)


def test_difference_within_the_tolerance_causes_no_opposing_torques(make, family):
    arm = make(family).start()
    arm.hold()
    before_rad = arm.ticks(2).joint_position_rad[0]
    arm.ticks(5, (0.0, 0.0, 0.0))
    _, second = shafts(arm)
    for servo in arm.servos.values():
        if servo.shaft is second:
            servo.shaft.slipped_rad, step_rad = 0.03, 2 * pi / 4096
    arm.arm.wires["motors"]._apply_faults = lambda *_: None  # which would set the horn right
    measurement = arm.ticks(5)
    assert measurement.encoder_status is Status.OK
    assert measurement.joint_position_rad[0] - before_rad == pytest.approx(0.015, abs=step_rad)
    assert np.abs([shaft.torque_nm for shaft in shafts(arm)]).max() < 0.02


def test_restarted_second_servo_is_named(make, family):
    arm = make(family).start()
    second = FAMILIES[family][2]
    arm.inject_fault("motors", FaultKind.REBOOT, device=second, times=1, delay_s=0.001)
    said = rf"servo {second} \(joint 1, second\): has lost|servo {second}: torque limit is 1000 instead"
    arm.ticks_until(lambda _: re.search(said, arm.problem), most=4)


def test_fault_names_a_servo_or_all(make):
    arm = make("feetech").start()
    arm.inject_fault("motors", FaultKind.REBOOT, device=FAMILIES["feetech"][2], times=1, delay_s=0.001)
    problems = [(arm.tick(), arm.problem)[1] for _ in range(14)]  # later requests find no free length
    assert "the servos did not answer in time" in problems
    assert not any("servo  " in problem for problem in problems)


@pytest.mark.parametrize("kind", [FaultKind.LIMP, FaultKind.REVERSED])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_opposing_dynamixel_is_named_while_positions_stay_valid(make, kind, sign):
    arm = make("dynamixel").start()
    torque_nm = (2.0 * sign, 0.0, 0.0)
    arm.ticks(5, torque_nm)
    arm.inject_fault("motors", kind, device=4)
    began_s = arm.clock.now_s()
    arm.ticks_until(lambda _: arm.problem, 20, torque_nm)
    assert 0.008 < arm.clock.now_s() - began_s < 0.013  # unresponsive_drive_s is 10 ms
    assert "servos 1 and 4 (joint 1) exert " in arm.problem
    assert "both were sent the same" in arm.problem
    measurement = arm.tick(torque_nm)
    assert (measurement.encoder_status, measurement.torque_status) == (Status.OK, Status.FAULT)


def test_feetech_that_ignores_goals_is_named(make):
    """The two are then springs about different goals."""
    arm = make("feetech").start()
    arm.inject_fault("motors", FaultKind.DEAF, device=7)
    arm.ticks_until(lambda _: arm.problem, 60, (1.0, 0.0, 0.0))
    assert "servos 2 and 7 (joint 1) exert " in arm.problem


def test_torque_difference_that_is_small_beside_the_limit_is_accepted(make):
    """3 % of the joint's 8 N m between them, and half of the larger."""
    arm = make("dynamixel").start()
    arm.inject_fault("motors", FaultKind.LIMP, device=4)
    assert not arm.ticks(50, (0.9, 0.0, 0.0)).torque_status
    arm.ticks_until(lambda _: arm.problem, 20, (1.05, 0.0, 0.0))


def test_two_dynamixels_are_limited_by_the_weaker(make):
    arm = make("dynamixel")
    arm.servos[4].memory.put(table.CURRENT_LIMIT, 100)
    arm.start()
    arm.robot.torque.stage_torque(np.full(3, 100.0))
    sent = arm.robot.torque.stage_torque(np.full(3, 100.0))
    assert sent[0] == pytest.approx(2 * 100 * DYNAMIXEL_STEP_NM)
    arm.ticks(2, np.full(3, 100.0))
    assert [shaft.torque_nm for shaft in shafts(arm)] == pytest.approx([100 * DYNAMIXEL_STEP_NM] * 2)


def test_torque_limit_of_each_feetech_is_for_its_half(make):
    slow = ("velocity_rad_s: [3.0, 3.0, 3.0]", "velocity_rad_s: [1.0, 1.0, 1.0]")
    arm = make("feetech", slow).start()
    stall_nm, no_load_rad_s = 30 * 0.0980665, pi / 3 / 0.222
    limits = {servo_id: servo.get(LIMIT) for servo_id, servo in arm.servos.items()}
    half = 1000 * (1.0 / stall_nm + 1.0 / no_load_rad_s)
    assert limits[2] == limits[7] == np.ceil(half)
    assert limits[3] == np.ceil(half + 1000 / stall_nm)


@pytest.mark.parametrize("place", [1, 4], ids=["first", "second"])
def test_another_homing_offset_is_refused(make, place):
    stated = (
        FAMILIES["dynamixel"][1][1],
        FAMILIES["dynamixel"][1][1].replace("3.1}", "3.1, homing_offset: 7}"),
    )
    stated = (stated[0], stated[1].replace("{id: 1,", "{id: 1, homing_offset: -100000,"))
    arm = make("dynamixel", stated)
    arm.robot.configure()  # as they are bolted on
    arm.robot.deactivate()
    arm.servos[place].memory.put(table.HOMING_OFFSET, 512)
    with pytest.raises(DeviceError, match=f"servo {place}: has a homing offset of 512, but the robot"):
        arm.robot.buses["motors"].configure()
    findings = {one.subject: one for one in arm.robot.buses["motors"].examine() if one.level is Level.FAIL}
    (found,) = findings.values()
    assert f"servo {place} (joint 1" in found.subject
    assert "has a homing offset of 512" in found.text


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_position_of_the_second_servo_is_in_the_same_turn_as_the_first(make, turns):
    """Whichever turn its zero is stated in, and at the edge of where the first one's is chosen."""
    zero = ("zero_rad: 3.1}", f"zero_rad: {3.1 + 2 * pi * turns:.6f}}}")
    measurement = make("dynamixel", zero).start().tick()
    assert measurement.encoder_status is Status.OK
    assert measurement.joint_position_rad[0] == pytest.approx(1.1573, abs=0.01)


def test_doctor_reports_the_zero_that_aligns_both_servos(make, family):
    arm = make(family)
    arm.robot.configure()
    motors, number = arm.robot.buses["motors"], FAMILIES[family][2]
    found = {one.subject: one for one in motors.examine()}
    assert {one.level for one in found.values()} == {Level.OK}
    first = min(arm.servos) if family == "dynamixel" else 2
    pair = f"servos {first} and {number} (joint 1)"
    assert {f"servo {first} (joint 1)", f"servo {number} (joint 1, second)", pair} <= set(found)
    arm.inject_fault("motors", FaultKind.SLIPPED, device=number)
    arm.ticks(2, None)
    (slipped,) = (one for one in motors.examine() if one.level is Level.FAIL)
    assert slipped.subject == pair
    assert "stand 0.10" in slipped.text
    zero_rad = {"dynamixel": 3.1, "feetech": 3.2}[family]
    assert float(slipped.remedy.rsplit(" ", 1)[1]) == pytest.approx(zero_rad - 0.1, abs=0.003)


def test_wrong_direction_is_refused_at_the_first_reading(make):
    arm = make("dynamixel")
    arm.servos[4]._direction *= -1
    arm.robot.configure()
    assert arm.tick(None).encoder_status is Status.FAULT
    assert re.search(r"servos 1 and 4 \(joint 1\) stand .* reversed wrong", arm.problem)
    assert arm.robot.buses["motors"].sample is None


def test_second_servo_shares_the_torque_constant_and_counts_in_the_identity():
    given = ONE | {"torque_constant_nm_a": 2.0, "reversed": True, "zero_rad": 1.0, "homing_offset": 5}
    (servo,) = validate(DynamixelSettings, {"port": "p", "servos": [given | {"second": {"id": 4}}]}).servos
    assert servo.second.torque_constant_nm_a == 2.0
    assert (servo.second.reversed, servo.second.zero_rad, servo.second.homing_offset) == (False, pi, None)
    text = DYNAMIXEL.read_text(encoding="utf-8").replace(*DYNAMIXEL_PAIR)
    bus = "    driver: dynamixel_bus\n"
    wider = text.replace(bus, bus + "    pair_tolerance_rad: 0.1\n")
    other = text.replace("zero_rad: 3.1}", "zero_rad: 3.2}")
    first, same, different = (
        device_identity(parse_robot_file(one, DYNAMIXEL), "encoder") for one in (text, wider, other)
    )
    assert first == same != different


ONE = {"id": 1, "model": "XM540-W270"}


def pair_on_the_middle_joint():
    """Three joints of 8 N m, of which two servos turn the second; the fourth servo is its second one."""
    servos = [ONE, ONE | {"id": 2, "second": {"id": 4}}, ONE | {"id": 3}]
    settings = validate(DynamixelSettings, {"port": "p", "servos": servos})
    return ServoPairs(settings, parse_robot_file(DYNAMIXEL.read_text(encoding="utf-8"), DYNAMIXEL).limits)


def test_stated_torque_constant_replaces_the_model_s():
    """2.69 mA a count, in either direction; a maker's constant is of a motor without its gears' losses."""
    stated = ONE | {"id": 2, "torque_constant_nm_a": 2.0, "reversed": True}
    settings = validate(DynamixelSettings, {"port": "p", "servos": [ONE, stated]})
    torque_nm = count_steps(settings.turning)[2]
    np.testing.assert_allclose(torque_nm, [DYNAMIXEL_STEP_NM, -0.00269 * 2.0], rtol=1e-3)


@pytest.mark.parametrize(
    ("torque_nm", "named"),
    [
        ([0.0, 2.0, 0.0, 2.0], False),
        ([2.0, 0.0, 2.0, 0.0], False),
        ([2.0, 2.0, 2.0, 0.0], True),
        ([2.0, 0.0, 2.0, 2.0], True),
    ],
)
def test_compared_torques_are_those_of_the_pair(torque_nm, named):
    pairs = pair_on_the_middle_joint()
    said = [pairs.torque_difference(np.array(torque_nm), 1e-3 * k) for k in range(20)][-1]
    assert (said is not None) is named
    assert not named or said.startswith("servos 2 and 4 (joint 2) exert ")


@pytest.mark.parametrize(("step_s", "named_at"), [(1e-3, 9), (4e-3, 4)])
def test_torque_difference_counts_after_ten_milliseconds_and_five_samples(step_s, named_at):
    """10 ms after the last equal sample, and in the fifth that differs."""
    pairs = pair_on_the_middle_joint()
    for begun_s in (0.0, 1.0):
        assert pairs.torque_difference(np.array([0.0, 2.0, 0.0, 2.0]), begun_s - step_s) is None
        times_s = [begun_s + step_s * k for k in range(named_at + 1)]
        said = [pairs.torque_difference(np.array([0.0, 2.0, 0.0, 0.0]), time_s) for time_s in times_s]
        assert [text is not None for text in said] == [False] * named_at + [True]


def test_second_servo_across_the_turn_edge_stays_beside_the_first():
    """The two stand 0.01 rad apart, half a turn from the middle of the range, one on either side of it."""
    servos = [ONE | {"second": {"id": 4}}]
    settings = validate(DynamixelSettings, {"port": "p", "servos": servos})
    limits = parse_robot_file(DYNAMIXEL.read_text(encoding="utf-8"), DYNAMIXEL).limits
    steps = np.array([[2 * pi / 4096] * 2, [1.0, 1.0], [1.0, 1.0]])
    joints = ServoJoints(settings.turning, ServoPairs(settings, limits), [0.0], steps)
    counts = ([-3, 4], [0, 0], [0, 0])
    joints.choose_turns(counts)
    first_rad, second_rad = joints.motion(counts)[0]
    assert abs(first_rad) == pytest.approx(pi, abs=0.01)
    assert second_rad - first_rad == pytest.approx(7 * steps[0, 0])


@pytest.mark.parametrize(
    ("largest_nm", "may_nm"),
    [([5.0, 1.0, 7.0, 3.0], [5.0, 1.0, 7.0, 1.0]), ([5.0, 3.0, 7.0, 1.0], [5.0, 1.0, 7.0, 1.0])],
)
def test_pair_limit_is_that_of_the_weaker(largest_nm, may_nm):
    assert pair_on_the_middle_joint().limit_to_weaker(largest_nm) == may_nm


STS = {"id": 1, "model": "STS3215-12V"}


@pytest.mark.parametrize(
    ("model", "servo", "said"),
    [
        (DynamixelSettings, ONE | {"second": {"id": 1}}, "id 1 appears twice"),
        (DynamixelSettings, ONE | {"second": {}}, "servos entry 1.second.id: is missing"),
        (DynamixelSettings, ONE | {"second": {"id": 4, "model": "XM430-W350"}}, "must have one model"),
        (DynamixelSettings, ONE | {"second": {"id": 4, "mirrored": True}}, "mirrored: is not known"),
        (DynamixelSettings, ONE | {"second": 4}, "servos entry 1.second"),
        (DynamixelSettings, ONE | {"second": {"id": 4, "second": {"id": 5}}}, "can have at most two servos"),
        (DynamixelSettings, ONE | {"homing_offset": 1_044_480}, "homing_offset"),
        (FeetechSettings, STS | {"second": {"id": 4, "homing_offset": 2048}}, "second.homing_offset"),
    ],
)
def test_invalid_servo_pair_is_refused(model, servo, said):
    with pytest.raises(InputError) as refused:
        validate(model, {"port": "p", "servos": [servo]})
    assert said in str(refused.value)
