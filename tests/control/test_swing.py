"""Before a run the arm may swing in free air: away from the object only, and as its limits allow."""

import numpy as np
import pytest

from control.loop.phases import Phase
from control.loop.result import Outcome
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from robot_io.errors import InputError
from robot_io.robot_file import load_robot_file
from tests.control.probing_runs import WIDE, plant_above, probing_task, run_probing
from tests.control.reference_plant import TOOL_AXIS_TIP, test_arm
from tests.control.simulated_arms import ARMS, SimulatedArm

SWING_M = 0.06
SHORT = {"speeds_m_s": (0.1,), "repeats": 2, "hold_s": 0.05, "settle_s": 0.05, "free_air_s": 0.1}
SWINGING = SHORT | {"free_air_swing_m": SWING_M, "free_air_swing_speeds_rad_s": (0.5, 1.5)}


def started(plan, **limits):
    """A task that has looked at its plan, on the reference arm."""
    task = ProbingTask(
        test_arm(),
        TOOL_AXIS_TIP,
        probing_task(plan)._gains,
        plan,
        **{"position_limits_rad": WIDE} | limits,
    )
    plant = plant_above()
    task.start(plant.measure())
    return task


def test_the_tip_swings_up_and_back_at_both_speeds_before_every_run():
    plant = plant_above(stiffness_n_m=2000.0, damping_n_s_m=20.0)
    task = probing_task(ProbingPlan(**SWINGING))
    record = run_probing(plant, task)
    assert task.failures == ()
    assert "no_swing" not in record.kinds()
    heights = np.array([output.tip_position_world_m[2] for output in record.outputs])
    speeds = np.array([np.abs(output.reference_velocity_rad_s).max() for output in record.outputs])
    for run in (0, 1):
        begin = 0 if run == 0 else int(np.flatnonzero(record.run == 0)[-1]) + 1
        end = int(np.flatnonzero(record.run == run)[0])
        assert (record.phase[begin:end] == Phase.MOVE).all()
        way = heights[begin:end]
        assert way.max() == pytest.approx(way[-1] + SWING_M, abs=1e-3)
        assert way.min() > way[-1] - 1e-3  # never towards the object
        assert (np.diff((way > way[-1] + 0.5 * SWING_M).astype(int)) == 1).sum() == 2
        halves = np.split(speeds[begin:end], np.flatnonzero(speeds[begin:end] == 0.0))
        peaks = [half.max() for half in halves if len(half) > 50]
        assert peaks[:2] == pytest.approx([0.5, 0.5], rel=0.01)
        assert all(0.5 < peak < 1.51 for peak in peaks[2:4])
        assert record.force_n[begin:end].max() == 0.0


def test_without_it_nothing_moves_but_what_did():
    records = [
        run_probing(plant_above(stiffness_n_m=2000.0, damping_n_s_m=20.0), probing_task(ProbingPlan(**plan)))
        for plan in (SHORT, SWINGING)
    ]
    torques = [record.torque_nm[record.run == 0] for record in records]
    plain_s, swung_s = (record.time_s[-1] for record in records)
    assert swung_s > plain_s + 2.0
    np.testing.assert_allclose(*torques, atol=0.02)  # the runs themselves are the same


def test_what_is_met_on_a_swing_sends_the_arm_home():
    plant = plant_above(stiffness_n_m=2000.0, damping_n_s_m=20.0)
    truth, pushed = plant.measure, []

    def measure():
        """A hand, for five ticks, when the tip comes up."""
        measurement = truth()
        if plant.body.tip_pose(plant.position_rad)[0][2] > 0.08 + 0.7 * SWING_M and len(pushed) < 5:
            pushed.append(plant.time_s)
            return measurement._replace(force_n=measurement.force_n + 7.0)
        return measurement

    plant.measure = measure
    task = probing_task(ProbingPlan(**SWINGING))
    record = run_probing(plant, task)
    assert record.kinds() == ["obstacle", "probing_done"]
    assert len(task.failures) == 1
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3
    assert record.time_s[-1] < pushed[0] + 3.0  # by the shortest way


def test_a_swing_beyond_what_the_joints_may_is_refused_before_anything_moves():
    home = plant_above().position_rad
    narrow = home - 0.5, home + np.array((0.2, 0.5, 0.5))
    plan = {**SHORT, "search_depth_m": 0.03, "max_depth_m": 0.01}
    started(ProbingPlan(**plan), position_limits_rad=narrow)
    with pytest.raises(
        InputError, match=r"free_air_swing_m 0.3 m: at target 1 .* lifted by \d+ mm only"
    ) as one:
        started(ProbingPlan(**plan, free_air_swing_m=0.3), position_limits_rad=narrow)
    assert "\n" not in str(one.value)


def test_a_swing_that_takes_more_torque_than_there_is_is_refused():
    plan = ProbingPlan(**SWINGING, joint_acceleration_rad_s2=4.0)
    started(plan, torque_limits_nm=np.full(3, 1e3))
    with pytest.raises(
        InputError, match=r"free_air_swing_m 0.06 m: .* joint 1 would need .* its limit is 0.5 N m"
    ):
        started(plan, torque_limits_nm=np.full(3, 0.5))


def test_a_swing_at_which_the_guard_trips_is_refused_and_one_not_asked_for_is_not():
    follower = load_robot_file(ARMS / "follower" / "follower.yaml")
    fast = {"free_air_swing_speeds_rad_s": (0.3, 7.0)}
    ProbingTask.from_robot_file(follower, ProbingPlan(**fast))
    with pytest.raises(InputError, match=r"free_air_swing_speeds_rad_s 7: the guard .* at most 5.45 rad/s"):
        ProbingTask.from_robot_file(follower, ProbingPlan(**fast, free_air_swing_m=0.1))


def test_the_guard_stays_quiet_on_a_joint_with_friction_that_nobody_knows_of():
    quick = {"repeats": 1, "speeds_m_s": (0.15,), "free_air_swing_speeds_rad_s": (2.0,)}
    plan = ProbingPlan(**SWINGING | quick)
    arm = SimulatedArm(
        "follower", plan, {"hidden": [{"effect": "coulomb_friction", "joint": 2, "coulomb_nm": 0.3}]}
    )
    result = arm.run()
    assert result.outcome is Outcome.FINISHED, result.cause
    assert arm.task.failures == ()
    moving = arm.log.column("phase") == Phase.MOVE
    turned = np.diff(np.sign(arm.log.column("reference_velocity_rad_s")[moving][:, 1]))
    assert (turned != 0).sum() >= 2


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("free_air_swing_m", -0.1),
        ("free_air_swing_m", 0.6),
        ("free_air_swing_speeds_rad_s", []),
        ("free_air_swing_speeds_rad_s", [0.01]),
    ],
)
def test_swings_that_make_no_sense_are_refused(key, value):
    with pytest.raises(ValueError, match=key):
        ProbingPlan(**{key: value})
