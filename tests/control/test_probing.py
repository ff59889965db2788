"""Probing task on the reference plant: phases, corner objects and failures."""

import numpy as np
import pytest

from palpate.control.arm.inverse_kinematics import Elbow
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import ContactGains, Gains
from palpate.control.loop.task import Phase
from palpate.control.paths.excitation import Excitation
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.errors import InputError, SafetyTripError
from tests.control.probing_runs import plant_above, probing_task, push, run_probing
from tests.control.reference_plant import TOOL_AXIS_TIP, arm_urdf

CORNERS = [(100.0, 0.0, 0.15), (100.0, 200.0, 0.06), (10_000.0, 200.0, 0.05), (10_000.0, 0.0, 0.05)]
NOISE = {"force_noise_n": 0.02, "velocity_noise_rad_s": 0.002}


def probe(stiffness=500.0, damping=20.0, gains=None, plant=None, **plan):
    plan = {"speeds_m_s": (0.15,), "hold_s": 0.4, "free_air_s": 0.1, "settle_s": 0.05} | plan
    plant = plant or plant_above(stiffness_n_m=stiffness, damping_n_s_m=damping, **NOISE)
    task = probing_task(ProbingPlan(**plan), gains)
    return run_probing(plant, task), task


@pytest.mark.parametrize(("stiffness", "damping", "speed_m_s"), CORNERS)
def test_corner_objects_are_probed_within_the_force_limit(stiffness, damping, speed_m_s):
    record, task = probe(stiffness, damping, speeds_m_s=(speed_m_s,), hold_s=0.8)
    assert task.failures == ()
    assert record.kinds() == ["free_air", "touch", "limit_reached", "held", "release", "probing_done"]
    assert record.force_after_touch(0, 0.020).max() <= 10.5
    hold = record.force_n[record.in_phase(Phase.HOLD)]
    assert abs(hold[-500:].mean() - 10.0) < 0.1
    assert hold[-500:].std() < 0.05
    assert hold.min() > 9.0
    assert np.abs(record.position_rad - record.reference_rad).max() < 0.005
    pressed = record.in_phase(Phase.LOADING) | record.in_phase(Phase.HOLD)
    assert (record.force_n[pressed] > 0.0).all()  # it does not bounce


@pytest.mark.parametrize("stiffness", [7100.0, 500.0])
def test_slow_sensor_does_not_destabilize_probing(stiffness):
    plant = plant_above(stiffness_n_m=stiffness, damping_n_s_m=100.0, force_delay_ticks=2)
    record, _ = probe(plant=plant, speeds_m_s=(0.05,))
    assert record.force_after_touch(0, 0.020).max() <= 10.5
    assert record.force_n[record.in_phase(Phase.HOLD)][-300:] == pytest.approx(10.0, abs=0.1)


def test_phases_of_a_run_are_in_order_with_consistent_references():
    record, _ = probe()
    changes = np.flatnonzero(np.diff(record.phase)) + 1
    order = " ".join(Phase(record.phase[i]).name for i in (0, *changes))
    assert order == "MOVE FREE_AIR APPROACH LOADING HOLD UNLOADING RETRACT MOVE IDLE"
    free_air = record.in_phase(Phase.FREE_AIR)
    assert free_air.sum() == pytest.approx(100, abs=2)
    assert not record.force_n[free_air].any()
    assert (record.run[(record.phase == Phase.MOVE) | (record.phase == Phase.IDLE)] == -1).all()
    outputs = record.outputs
    assert outputs[-1].done
    assert not outputs[-2].done
    assert all(np.isnan(output.desired_force_n) for output in outputs if output.phase == Phase.APPROACH)
    assert all(output.desired_force_n == 10.0 for output in outputs if output.phase == Phase.HOLD)
    assert all(output.press_direction_world == pytest.approx((0, 0, -1)) for output in outputs)
    rate = np.array([output.reference_velocity_rad_s for output in outputs])
    slope = np.diff(record.reference_rad, axis=0) / 0.001
    assert np.abs((rate[1:] + rate[:-1]) / 2 - slope).max() < 0.03


def test_touch_and_loading_keep_the_set_speed():
    record, _ = probe(stiffness=500.0, damping=0.0, speeds_m_s=(0.09,))
    down = np.array([-output.tip_velocity_world_m_s[2] for output in record.outputs])
    early = record.in_phase(Phase.LOADING) & (record.force_n < 7.0)
    assert early.sum() > 50
    assert down[early] == pytest.approx(np.full(early.sum(), 0.09), abs=0.003)
    touch = record.event("touch")
    assert touch.data["surface_world_m"][2] == pytest.approx(0.05, abs=5e-4)
    assert "not reached" not in touch.text


def test_speeds_and_targets_are_all_run():
    record, task = probe(
        speeds_m_s=(0.15, 0.12),
        targets_world_m=((0.42, 0.0, 0.05), (0.40, 0.0, 0.055)),
        **{"hold_s": 0.1, "free_air_s": 0.1},
    )
    assert task.failures == ()
    touches = [event for _, event in record.events if event.kind == "touch"]
    assert [event.data["run"] for event in touches] == list(range(4))
    assert [event.data["target"] for event in touches] == [0, 0, 1, 1]
    places = np.array([event.data["surface_world_m"] for event in touches])
    assert places[:, 2] == pytest.approx(np.full(4, 0.05), abs=5e-4)
    assert places[:, 0] == pytest.approx([0.42, 0.42, 0.40, 0.40], abs=1e-6)
    assert set(record.run) == {-1, *range(4)}


def test_next_approach_starts_above_the_detected_surface():
    plant = plant_above(height_m=0.15, stiffness_n_m=500.0)
    record, _ = probe(plant=plant, speeds_m_s=(0.15, 0.15), hold_s=0.1, retract_m=0.02)
    height = np.array([output.tip_position_world_m[2] for output in record.outputs])
    assert height[record.in_phase(Phase.FREE_AIR, 0)] == pytest.approx(0.15, abs=1e-3)
    assert height[record.in_phase(Phase.FREE_AIR, 1)] == pytest.approx(0.07, abs=1e-3)


@pytest.mark.parametrize("elbow", list(Elbow))
def test_elbow_configuration_is_kept(elbow):
    plant = plant_above(elbow=elbow, stiffness_n_m=500.0)
    start = plant.position_rad.copy()
    record, task = probe(plant=plant)
    assert task.failures == ()
    assert np.abs(record.position_rad - start).max() < 0.6


def test_missing_surface_is_an_event_and_the_next_target_is_tried():
    plan = {"targets_world_m": ((0.42, 0.0, 0.2), (0.42, 0.0, 0.05)), "search_depth_m": 0.06}
    record, task = probe(speeds_m_s=(0.09, 0.05), hold_s=0.1, **plan)
    missed = [event for _, event in record.events if event.kind == "missed_surface"]
    assert len(missed) == 1  # the second speed is not tried in vain
    assert task.failures == (missed[0].text,)
    assert "no touch within 60 mm" in missed[0].text
    assert "from z = 230 mm to 170 mm" in missed[0].text
    assert record.kinds().count("limit_reached") == record.kinds().count("release") == 2
    assert record.event("probing_done").data["runs"] == 2
    assert record.outputs[-1].done


def test_soft_object_is_left_at_the_depth_limit_and_slow_loading_goes_on():
    record, task = probe(stiffness=100.0, damping=0.0, max_depth_m=0.03)
    assert record.event("depth_limit").data["depth_m"] < 0.03
    lowest = min(output.tip_position_world_m[2] for output in record.outputs)
    assert 0.05 - lowest <= 0.032  # a soft surface is found 1.5 mm late
    assert record.force_n.max() < 3.5
    assert task.failures == ()
    assert Phase.HOLD not in record.phase
    record, _ = probe(stiffness=500.0, damping=0.0, speeds_m_s=(0.01,), load_time_limit_s=0.5, hold_s=1.5)
    assert record.event("load_time_limit").data["force_n"] == pytest.approx(2.5, abs=0.5)
    assert record.force_n[record.in_phase(Phase.HOLD)][-1] == pytest.approx(10.0, abs=0.1)


def test_touch_before_the_set_speed_is_reported():
    record, _ = probe(plant=plant_above(height_m=0.052, stiffness_n_m=500.0))
    assert "set speed 150 mm/s was not reached" in record.event("touch").text
    assert record.event("touch").data["tip_m_s"] < 0.14


def back_at_the_start(record) -> bool:
    return record.outputs[-1].done and np.abs(record.position_rad[-1] - record.position_rad[0]).max() < 1e-3


@pytest.mark.parametrize(
    "plan",
    [
        {},
        {"search_depth_m": 0.02},  # no touch
        {"targets_world_m": ((0.40, 0.0, 0.05), (0.44, 0.0, 0.05))},
        {"max_depth_m": 0.005},
    ],
)
def test_task_ends_at_its_start_at_rest(plan):
    record, _ = probe(hold_s=0.1, settle_s=0.05, **plan)
    assert back_at_the_start(record)
    speed = np.abs(np.diff(record.position_rad[-3:], axis=0)).max() / 0.001
    assert speed < 0.01
    assert record.kinds()[-1] == "probing_done"


def test_moving_arm_is_not_released():
    plant = plant_above(stiffness_n_m=500.0)
    elsewhere = ((0.38, 0.0, 0.07),)  # the way back takes longer than the controller does to the creep
    task = probing_task(ProbingPlan(speeds_m_s=(0.09,), search_depth_m=0.02, targets_world_m=elsewhere))
    truth = plant.measure

    def measure():
        measurement = truth()
        if not task.failures:
            return measurement
        creep = np.array([0.0, 0.1, 0.0])
        return measurement._replace(joint_velocity_rad_s=measurement.joint_velocity_rad_s + creep)

    plant.measure = measure
    with pytest.raises(SafetyTripError, match=r"2.0 s after .* still moves at 0.1 rad/s"):
        run_probing(plant, task)


def test_obstacle_on_the_way_back_ends_with_the_guard():
    plant = plant_above(height_m=0.12, stiffness_n_m=500.0)
    task = probing_task(ProbingPlan(speeds_m_s=(0.15,), hold_s=0.1))
    began = []

    def force_n():
        """From the last move on a hand pushes."""
        began.append(plant.time_s > 1.0 and task._phase is Phase.MOVE and not task._run)
        return 6.0 * began[-1]

    push(plant, force_n)
    with pytest.raises(SafetyTripError, match=r"6.0 N on the way back to the start of the task"):
        run_probing(plant, task)
    assert sum(began) == 3


def test_arm_brakes_smoothly_at_an_obstacle_and_goes_back():
    plant = plant_above(height_m=0.12, stiffness_n_m=2000.0)
    plan = {"targets_world_m": ((0.42, 0.0, 0.02),), "approach_clearance_m": 0.02}  # hover below the surface
    record, task = probe(plant=plant, **plan)
    assert record.kinds() == ["obstacle", "probing_done"]
    assert "something is in the way" in task.failures[0]
    assert back_at_the_start(record)
    met = next(i for i, output in enumerate(record.outputs) if output.events)
    rate = np.array([output.reference_velocity_rad_s for output in record.outputs])
    assert np.abs(rate[met]).max() > 0.1
    braking_rad_s2 = np.abs(np.diff(rate, axis=0)).max() / 0.001
    assert braking_rad_s2 < 5.0 * 4.0 + 1.0  # five times the plan's acceleration
    slope = np.diff(record.reference_rad, axis=0) / 0.001
    assert np.abs((rate[1:] + rate[:-1]) / 2 - slope).max() < 1e-3
    still = np.flatnonzero(np.abs(rate[met:]).max(axis=1) < 1e-9)[0]
    assert still < 50  # ticks
    assert record.force_n.max() < 8.0  # it was noticed at 5 N


RIDES = {
    "hold": None,
    "force": Excitation(shape="chirp", quantity="force", duration_s=2.0),
    "position": Excitation(shape="chirp", quantity="position", duration_s=2.0),
}


@pytest.mark.parametrize("ride", RIDES)
def test_removed_object_is_not_chased_and_not_held(ride):
    plant = plant_above(stiffness_n_m=500.0, damping_n_s_m=20.0, **NOISE)
    task = probing_task(ProbingPlan(speeds_m_s=(0.15, 0.09), hold_s=0.5, excitation=RIDES[ride]))
    step, taken_after_s = task.step, 0.2 if ride == "hold" else 0.8
    held_ticks, heights = 0, []

    def watched_step(measurement, dt_s):
        nonlocal held_ticks
        output = step(measurement, dt_s)
        held_ticks += output.phase is Phase.HOLD
        if held_ticks * dt_s > taken_after_s:
            plant.surface_height_m = -1.0
            heights.append(output.tip_position_world_m[2])
        return output

    task.step = watched_step
    record = run_probing(plant, task)
    kinds = record.kinds()
    assert "contact_lost" in kinds
    assert "held" not in kinds or ride != "hold"
    assert len(task.failures) == 1  # and the other speed is not tried on nothing
    assert "contact lost while holding" in task.failures[0]
    assert record.event("probing_done").data["runs"] == 0
    assert heights[0] - min(heights) < 0.004
    assert back_at_the_start(record)


def test_force_bias_changes_nothing_and_noise_raises_the_touch_threshold():
    plant = plant_above(stiffness_n_m=500.0, force_bias_n=4.0, **NOISE)
    record, _ = probe(plant=plant)
    assert record.event("free_air").data["mean_n"] == pytest.approx(4.0, abs=0.02)
    assert record.force_n[record.in_phase(Phase.HOLD)][-300:].mean() == pytest.approx(10.0, abs=0.1)
    plant = plant_above(stiffness_n_m=500.0, force_noise_n=0.3)
    record, task = probe(plant=plant)
    assert task.failures == ()
    assert record.event("free_air").data["touch_n"] == pytest.approx(1.8, abs=0.3)
    assert record.event("touch").data["surface_world_m"][2] == pytest.approx(0.05, abs=0.004)


@pytest.mark.parametrize(
    ("shape", "quantity", "stiffness", "damping"),
    [  # every two of them meet
        ("multisine", "force", 500.0, 20.0),
        ("multisine", "position", 7100.0, 100.0),
        ("chirp", "force", 7100.0, 100.0),
        ("chirp", "position", 500.0, 20.0),
    ],
)
def test_excitation_moves_the_object_and_keeps_the_limit(shape, quantity, stiffness, damping):
    excitation = Excitation(shape=shape, quantity=quantity, duration_s=2.0)
    record, _ = probe(stiffness, damping, speeds_m_s=(0.05,), hold_s=0.4, excitation=excitation)
    begun_s = next(time_s for time_s, event in record.events if event.kind == "excitation")
    excited = record.in_phase(Phase.HOLD) & (record.time_s > begun_s + 0.5)
    force = record.force_n[excited]
    assert force.max() <= 10.5
    assert force.min() > 5.0
    assert np.ptp(force) > 1.5
    kinds = record.kinds()
    assert kinds.index("held") < kinds.index("excitation") < kinds.index("release")
    assert "excitation_too_strong" not in kinds


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ({"targets_world_m": ((0.9, 0.0, 0.05),)}, r"target 1 \(900, 0, 80 mm\): target out of reach"),
        ({"targets_world_m": ((0.42, 0.2, 0.05),)}, "200 mm out of the arm's plane"),
        ({"press_direction_world": (0.0, 1.0, 0.0)}, "does not lie in the arm's plane"),
        ({"targets_world_m": ((0.5999, 0.0, -0.15),)}, "singular"),
    ],
)
def test_unreachable_plan_is_refused_before_motion(plan, message):
    task = probing_task(ProbingPlan(**plan))
    with pytest.raises(InputError, match=message):
        task.start(plant_above().measure())


def test_joint_limits_bound_the_search():
    plant = plant_above(height_m=0.3, x_m=0.35)
    plan = ProbingPlan(search_depth_m=0.5)
    low, high = plant.position_rad - 0.15, plant.position_rad + 0.15
    task = probing_task(plan, limits=(low, high))
    record = run_probing(plant, task)
    assert "no touch within" in task.failures[0]
    assert (record.reference_rad >= low - 1e-6).all()
    assert (record.reference_rad <= high + 1e-6).all()
    task = probing_task(plan, limits=(plant.position_rad - 0.001, plant.position_rad + 0.001))
    with pytest.raises(InputError, match="within its joint limits"):
        task.start(plant.measure())


def test_urdf_limits_apply_without_other_limits():
    limits = [(angle - 0.001, angle + 0.001) for angle in plant_above().position_rad]
    body = RigidBody.from_urdf(arm_urdf(limits=limits), "tip")
    task = ProbingTask(body, TOOL_AXIS_TIP, Gains(), ProbingPlan())
    with pytest.raises(InputError, match="within its joint limits"):
        task.start(plant_above().measure())


def test_hold_works_without_force_feedforward():
    gains = Gains(contact=ContactGains(force_feedforward=0.0))
    record, _ = probe(stiffness=2000.0, damping=20.0, gains=gains, speeds_m_s=(0.05,), hold_s=1.0)
    assert record.force_n[record.in_phase(Phase.HOLD)][-300:].mean() == pytest.approx(10.0, abs=0.1)
    assert record.force_after_touch(0, 0.02).max() < 11.0


def test_task_can_be_started_again():
    task = probing_task(ProbingPlan(speeds_m_s=(0.09,), hold_s=0.1))
    for _ in range(2):
        record = run_probing(plant_above(stiffness_n_m=500.0, **NOISE), task)
        assert record.kinds().count("limit_reached") == 1
