"""Routes in free air: clearance between targets, and swings before a run."""

from functools import cache

import numpy as np
import pytest

from palpate.control.arm.inverse_kinematics import PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import Phase
from palpate.control.paths.trajectory import JointPath, LineState
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.routes import RouteEnd, Routes
from palpate.control.probing.sites import probing_sites
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Measurement
from tests.control.probing_runs import plant_above, probing_task, push, run_probing, started
from tests.control.simulated_arms import ARMS, NAMES, SimulatedArm, kelvin_voigt

SWING_M = 0.06
SHORT = {"speeds_m_s": (0.1,), "repeats": 2, "hold_s": 0.05, "settle_s": 0.05, "free_air_s": 0.1}
SWINGING = SHORT | {"free_air_swing_m": SWING_M, "free_air_swing_speeds_rad_s": (0.5, 1.5)}
SURFACE_M = 0.05
FAR_APART = [(0.25, 0.45, 0.005), (0.2, 0.5, 0.015), (0.16, 0.5, 0.03), (0.45, 0.25, 0.005)]


def a_hand(plant, comes):
    """Pushes for five ticks from when it `comes(tip_m)` on; returns when it did."""
    pushed = []

    def force_n():
        if len(pushed) == 5 or not comes(plant.body.tip_pose(plant.position_rad)[0]):
            return 0.0
        pushed.append(plant.time_s)
        return 7.0

    push(plant, force_n)
    return pushed


@cache
def probed(swing_m):
    """What happens with swings of that height, or none."""
    task = probing_task(ProbingPlan(**SWINGING | {"free_air_swing_m": swing_m}))
    record = run_probing(plant_above(stiffness_n_m=2000.0, damping_n_s_m=20.0), task)
    assert task.failures == ()
    return record


def test_tip_swings_up_and_back_at_both_speeds_before_every_run():
    record = probed(SWING_M)
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


def test_swing_does_not_change_the_runs():
    records = [probed(swing_m) for swing_m in (0.0, SWING_M)]
    torques = [record.torque_nm[record.run == 0] for record in records]
    plain_s, swung_s = (record.time_s[-1] for record in records)
    assert swung_s > plain_s + 2.0
    np.testing.assert_allclose(*torques, atol=0.02)  # the runs themselves are the same


def test_contact_during_a_swing_sends_the_arm_home():
    plant = plant_above(stiffness_n_m=2000.0, damping_n_s_m=20.0)
    pushed = a_hand(plant, lambda tip_m: tip_m[2] > 0.08 + 0.7 * SWING_M)  # when the tip comes up
    task = probing_task(ProbingPlan(**SWINGING))
    record = run_probing(plant, task)
    assert record.kinds() == ["obstacle", "probing_done"]
    assert len(task.failures) == 1
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3
    assert record.time_s[-1] < pushed[0] + 3.0  # by the shortest way


def test_swing_beyond_the_joints_or_the_torque_is_refused_before_moving():
    home = plant_above().position_rad
    narrow = home - 0.5, home + np.array((0.2, 0.5, 0.5))
    plan = {**SHORT, "search_depth_m": 0.03, "max_depth_m": 0.01}
    started(ProbingPlan(**plan), limits=narrow)
    with pytest.raises(
        InputError, match=r"free_air_swing_m 0.3 m: at target 1 .* a lift of at most [\d.]+ m$"
    ) as one:
        started(ProbingPlan(**plan, free_air_swing_m=0.3), limits=narrow)
    assert "\n" not in str(one.value)
    plan = ProbingPlan(**SWINGING, joint_acceleration_rad_s2=4.0)
    started(plan, torque_limits_nm=np.full(3, 1e3))
    with pytest.raises(InputError, match=r"free_air_swing_m 0.06 m: .* joint 1 would .* limit is 0.5 N m"):
        started(plan, torque_limits_nm=np.full(3, 0.5))


def test_swing_that_trips_the_guard_is_refused_only_if_requested():
    follower = load_robot_file(ARMS / "follower" / "follower.yaml")
    fast = {"free_air_swing_speeds_rad_s": (0.3, 7.0)}
    ProbingTask.from_robot_file(follower, ProbingPlan(**fast))
    with pytest.raises(InputError, match=r"free_air_swing_speeds_rad_s 7: the guard .* at most 5.45 rad/s"):
        ProbingTask.from_robot_file(follower, ProbingPlan(**fast, free_air_swing_m=0.1))


def test_guard_does_not_trip_on_unmodeled_friction():
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
def test_invalid_swings_are_refused(key, value):
    with pytest.raises(ValueError, match=key):
        ProbingPlan(**{key: value})


def plan_of(targets, clearance_m, **more) -> ProbingPlan:
    return ProbingPlan(
        speeds_m_s=(0.1,),
        retract_m=clearance_m,
        approach_clearance_m=clearance_m,
        targets_world_m=tuple((x_m, 0.0, z_m) for x_m, z_m in targets),
        **more,
    )


class ProbingSetup:
    """Sites and ways of a shipped arm that stands at home."""

    def __init__(self, name: str, plan: ProbingPlan) -> None:
        self.robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
        self.body = RigidBody.of_robot(self.robot_file)
        arm = PlanarArm(self.body, np.array(self.robot_file.sensor_axis_tip))
        limits = self.robot_file.limits
        home = np.array(self.robot_file.home_rad)
        bounds = np.array(limits.position_min_rad), np.array(limits.position_max_rad)
        self.sites = probing_sites(arm, plan, self.body.tip_pose(home)[0], home, bounds)
        self.routes = Routes(arm, plan)
        here, self.places = home, []
        for site in self.sites:
            here = site.joint_position_rad(here)
            self.places.append(RouteEnd(here, site))

    def heights_m(self, points_rad) -> np.ndarray:
        """Of the tip on a way, by the forward kinematics of the URDF."""
        way = JointPath(points_rad, 1.0, 4.0)
        times = np.linspace(0.0, way.duration_s, 500)
        return np.array([self.body.tip_pose(way.at(t).position_rad)[0][2] for t in times])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("x1", "x2", "clearance_m"), FAR_APART)
def test_route_preserves_half_of_the_clearance(name, x1, x2, clearance_m):
    setup = ProbingSetup(name, plan_of([(x1, SURFACE_M), (x2, SURFACE_M)], clearance_m))
    passage = setup.routes.find(*setup.places)
    assert passage.clearance_deficit_m == 0.0
    assert passage.points_rad[0] is setup.places[0].position_rad
    assert passage.points_rad[-1] is setup.places[1].position_rad
    heights = setup.heights_m(passage.points_rad)
    assert heights.min() >= SURFACE_M + 0.5 * clearance_m - 1e-4
    assert heights.max() < SURFACE_M + clearance_m + 0.03  # and no higher than it needs


def test_clear_route_is_straight():
    setup = ProbingSetup("follower", plan_of([(0.4, SURFACE_M), (0.44, SURFACE_M)], 0.03))
    assert len(setup.routes.find(*setup.places).points_rad) == 2


@pytest.mark.parametrize("order", [1, -1])
def test_route_rises_before_a_step_and_descends_behind_it(order):
    low, high = (0.36, SURFACE_M), (0.42, SURFACE_M + 0.06)
    setup = ProbingSetup("follower", plan_of([low, high][::order], 0.02))
    points = setup.routes.find(*setup.places).points_rad
    tips = np.array([setup.body.tip_pose(point)[0] for point in points])
    beside = np.argmin(tips[:, 2])  # at the low target; the way goes straight up from there
    above = beside + order
    assert tips[above, 0] == pytest.approx(tips[beside, 0], abs=1e-6)
    assert tips[above, 2] >= high[1] + 0.02 - 1e-6


@pytest.mark.parametrize(
    ("x1", "x2", "clearance_m"), [FAR_APART[0], pytest.param(*FAR_APART[1], marks=pytest.mark.slow)]
)
def test_nothing_is_touched_on_the_way(x1, x2, clearance_m):
    plan = plan_of(
        [(x1, SURFACE_M), (x2, SURFACE_M)], clearance_m, hold_s=0.05, free_air_s=0.1, travel_speed_m_s=0.1
    )
    arm = SimulatedArm("follower", plan, kelvin_voigt(2000.0, surface_m=SURFACE_M))
    result = arm.run()
    assert result.outcome is Outcome.FINISHED, result.cause
    assert arm.task.failures == ()
    phase, time_s = arm.log.column("phase"), arm.log.column("time_s")
    moving = np.isin(np.round(arm.truth[:, 0], 6), np.round(time_s[phase == Phase.MOVE], 6))
    assert moving.sum() > 1000
    assert arm.truth[moving, 2].max() == 0.0
    assert arm.truth[moving, 1].min() > SURFACE_M + 0.3 * clearance_m


def test_targets_without_room_to_lift_the_tip_are_refused():
    plan = plan_of([(0.2, SURFACE_M), (0.5, SURFACE_M)], 0.015, search_depth_m=0.02, max_depth_m=0.01)
    setup = ProbingSetup("follower", plan)
    pressed = [
        site.line.joint_motion(LineState(0.03), near_rad).position_rad for near_rad, site in setup.places
    ]
    postures = np.array([*(place.position_rad for place in setup.places), *pressed])
    limits = postures.min(axis=0) - 0.01, postures.max(axis=0) + 0.01
    axis = np.array(setup.robot_file.sensor_axis_tip)
    task = ProbingTask.from_robot_file(setup.robot_file, plan)
    task = ProbingTask(setup.body, axis, task._gains, plan, position_limits_rad=limits)
    at, still = setup.places[0].position_rad, np.zeros(3)
    with pytest.raises(InputError, match=r"on the way to target 2 the tip would come .* mm too close"):
        task.start(Measurement(0.0, at, still, still, 0.0, 0.0, 0.0, 0.0))


def test_tips_in_the_plane_are_those_of_the_urdf():
    rng = np.random.default_rng(3)
    for name in NAMES:
        robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
        body = RigidBody.of_robot(robot_file)
        arm = PlanarArm(body, np.array(robot_file.sensor_axis_tip))
        position_rad = rng.uniform(-3.0, 3.0, (20, 3))
        expected = [arm.plane_point(body.tip_pose(row)[0]) for row in position_rad]
        np.testing.assert_allclose(arm.tips_in_plane(position_rad), expected, atol=1e-12)


TWO = {"targets_world_m": ((0.40, 0.0, SURFACE_M), (0.44, 0.0, SURFACE_M)), "speeds_m_s": (0.09,)}


def test_contact_between_targets_returns_the_arm_along_its_path():
    plant = plant_above(height_m=0.15, x_m=0.36, stiffness_n_m=2000.0, damping_n_s_m=20.0)
    task = probing_task(ProbingPlan(**TWO, hold_s=0.05, settle_s=0.05, free_air_s=0.1))
    a_hand(plant, lambda tip_m: tip_m[0] > 0.42)  # when the tip is half way
    record = run_probing(plant, task)
    assert record.kinds()[-2:] == ["obstacle", "probing_done"]
    assert len(task.failures) == 1
    tips = np.array([output.tip_position_world_m for output in record.outputs])
    assert 0.42 < tips[:, 0].max() < 0.43  # it did not go on
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3
    met = int(np.argmax(tips[:, 0]))
    over_the_first = met + int(np.argmin(np.linalg.norm(tips[met:, :3:2] - (0.40, 0.08), axis=1)))
    assert tips[over_the_first, :3:2] == pytest.approx((0.40, 0.08), abs=2e-3)  # where it had come from
    assert record.force_n[met:].max() == 0.0


def test_target_that_became_unreachable_is_skipped(monkeypatch):
    task = probing_task(ProbingPlan(**TWO, repeats=2, hold_s=0.05, settle_s=0.05, free_air_s=0.1))
    plant = plant_above(height_m=0.15, stiffness_n_m=2000.0, damping_n_s_m=20.0)
    find = Routes.find

    def blocked(self, start, end):
        passage = find(self, start, end)
        to_the_second = bool(start.site) and end.site not in (None, start.site)
        return (
            passage._replace(clearance_deficit_m=0.004) if to_the_second and plant.time_s > 0.0 else passage
        )

    monkeypatch.setattr(Routes, "find", blocked)
    record = run_probing(plant, task)
    assert [event.kind for _, event in record.events][-2:] == ["no_way", "probing_done"]
    (failure,) = task.failures
    assert "on the way to target 2 the tip would come 4.0 mm too close" in failure
    assert record.event("probing_done").data["runs"] == 2
    assert np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3
