"""Guard: trips, limits, safe stop and rearming."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.errors import InputError, SafetyTripError
from palpate.robot_io.guard import Guard, Limits, SafeState
from palpate.robot_io.guard.plausibility import StuckEncoders
from palpate.robot_io.types import Command, Measurement, Status
from tests.mock_robot import build_mock_robot, mock_bus, mock_robot_file

DT = 1e-3
LIMITS = Limits(
    torque_nm=(10.0, 5.0),
    torque_rate_nm_s=(1000.0, 500.0),
    position_min_rad=(-1.0, -2.0),
    position_max_rad=(1.0, 2.0),
    velocity_rad_s=(3.0, 4.0),
    force_n=20.0,
    tracking_rad=(0.1, 0.2),
    encoder_age_s=0.005,
    torque_age_s=0.010,
    force_age_s=0.020,
)
SAFE_STATE = SafeState(damping_nms_rad=(2.0, 1.0), stop_time_s=0.05)
nan, inf = math.nan, math.inf


def measured(time_s=0.0, **changes):
    """A measurement in which all is well, two joints, but for `changes`."""
    values = {
        "time_s": time_s,
        "joint_position_rad": [0.0, 0.0],
        "joint_velocity_rad_s": [0.0, 0.0],
        "joint_torque_nm": [0.0, 0.0],
        "force_n": 0.0,
        "encoder_at_s": time_s,
        "torque_at_s": time_s,
        "force_at_s": time_s,
    } | changes
    for key in ("joint_position_rad", "joint_velocity_rad_s", "joint_torque_nm"):
        values[key] = np.array(values[key], dtype=float)
    return Measurement(**values)


def torque(*values):
    return Command(np.array(values, dtype=float))


def limited(guard, command, measurement, dt_s=DT):
    return guard.limit(command, measurement, dt_s).joint_torque_nm.tolist()


@pytest.mark.parametrize(("joints", "damped"), [(3, (2.0, 1.0)), (2, (2.0, 1.0, 0.5)), (3, (2.0, 1.0, 0.5))])
def test_limits_and_safe_state_of_another_joint_count_are_refused(joints, damped):
    safe_state = SafeState(damping_nms_rad=damped, stop_time_s=0.05)
    said = f"{joints} joints, but its limits have 2 and its safe state {len(damped)}"
    with pytest.raises(InputError, match=said):
        Guard(LIMITS, safe_state, joints)


@pytest.fixture
def guard():
    return Guard(LIMITS, SAFE_STATE, 2)


WRONG = [
    ({"joint_position_rad": [1.01, 0]}, "joint 1 is at 1.01 rad, limits -1 to 1 rad"),
    ({"joint_position_rad": [0, -2.01]}, "joint 2 is at -2.01 rad"),
    ({"joint_position_rad": [0, nan]}, "joint 2 is at nan rad"),
    ({"joint_velocity_rad_s": [0, 4.01]}, "joint 2 moves at 4.01 rad/s, limit 4 rad/s"),
    ({"joint_velocity_rad_s": [-3.01, 0]}, "joint 1 moves at -3.01 rad/s"),
    ({"joint_velocity_rad_s": [nan, 0]}, "joint 1 moves at nan rad/s"),
    ({"joint_torque_nm": [0, inf]}, "joint 2: its measured torque is inf"),
    ({"force_n": 20.1}, "contact force is 20.1 N, limit 20 N"),
    ({"force_n": -20.1}, "contact force is -20.1 N"),
    ({"force_n": nan}, "contact force is nan N"),
    ({"encoder_at_s": 0.994}, "encoder: newest sample is 0.006 s old, limit 0.005 s"),
    ({"torque_at_s": 0.989}, "drives: newest sample is 0.011 s old"),
    ({"force_at_s": 0.979}, "force sensor: newest sample is 0.021 s old"),
    ({"encoder_at_s": -inf}, "encoder: no sample yet"),
    ({"force_at_s": nan}, "force sensor: newest sample is nan s old"),
    ({"encoder_at_s": inf}, "encoder: newest sample is -inf s old"),
    ({"encoder_status": Status.FAULT}, "encoder: reports a fault"),
    ({"torque_status": Status.FAULT}, "drives: reports a fault"),
    ({"force_status": Status.FAULT}, "force sensor: reports a fault"),
    ({"force_status": Status.SATURATED}, "force sensor: at the end of its range"),
    ({"encoder_status": Status.SATURATED}, "encoder: at the end of its range"),
    ({"time_s": nan}, "time went from"),
]


@pytest.mark.parametrize(("changes", "cause"), WRONG, ids=[cause for _, cause in WRONG])
def test_each_violation_trips_with_its_cause(guard, changes, cause):
    guard.watch(measured(**({"time_s": 1.0} | changes)))
    assert cause in guard.tripped.cause
    assert guard.tripped.tick == 0


@pytest.mark.parametrize(
    ("changes", "reference", "remedy"),
    [
        ({"joint_position_rad": [1.01, 0]}, None, "position_min_rad"),
        ({"joint_velocity_rad_s": [0, 4.01]}, None, "velocity_rad_s"),
        ({"force_n": 20.1}, None, "force_n"),
        ({"force_at_s": 0.5}, None, "check cable and supply"),
        ({"encoder_status": Status.FAULT}, None, "palpate doctor"),
        ({"force_status": Status.SATURATED}, None, "ranges"),
        ({}, [0.11, 0], "palpate doctor --move"),
        ({"joint_torque_nm": [nan, 0]}, None, ""),
    ],
    ids=str,
)
def test_each_trip_has_its_remedy(guard, changes, reference, remedy):
    guard.watch(measured(1.0, **changes), None if reference is None else np.array(reference))
    assert bool(remedy) == bool(guard.tripped.remedy)
    assert remedy in guard.tripped.remedy


def test_valid_measurement_does_not_trip(guard):
    guard.watch(measured(1.0))
    edge = {"joint_position_rad": [1.0, -2.0], "joint_velocity_rad_s": [3.0, -4.0], "force_n": 20.0}
    guard.watch(measured(1.001, **edge))
    # Old but not too old; sampled while the tick was being read; a drive at the end of its range.
    stale = {"encoder_status": Status.STALE, "encoder_at_s": 0.998, "torque_status": Status.SATURATED}
    guard.watch(measured(1.002, **stale))
    guard.watch(measured(1.003, encoder_at_s=1.0035))
    guard.watch(measured(1.004, encoder_at_s=1.1))  # reading took long; the robot knows when it ended
    assert guard.tripped is None
    assert not guard.finished


def test_time_must_not_go_backwards(guard):
    guard.watch(measured(1.0))
    guard.watch(measured(1.0))  # standing still is no harm by itself: ages tell
    assert guard.tripped is None
    guard.watch(measured(0.999))
    assert "time went from 1.000000 s to 0.999000 s" in guard.tripped.cause


@pytest.mark.parametrize(
    ("reference", "trips"),
    [([0.1, -0.2], False), ([0.11, 0], True), ([0, -0.21], True), ([0, nan], True), (None, False)],
)
def test_tracking_error_trips_beyond_its_limit(guard, reference, trips):
    guard.watch(measured(), None if reference is None else np.array(reference))
    assert bool(guard.tripped) == trips
    assert not trips or "off its reference" in guard.tripped.cause


def test_reference_may_come_later_in_the_tick(guard):
    measurement = measured()
    guard.watch(measurement)
    guard.watch(measurement, np.array([0.5, 0.0]))
    assert guard.tripped.tick == 0


def test_first_cause_stays(guard):
    guard.watch(measured(0.0))
    guard.watch(measured(0.001, force_n=25.0))
    trip = guard.tripped
    guard.watch(measured(0.002, joint_position_rad=[9, 9]))
    assert guard.trip("Ctrl-C") is trip
    assert guard.tripped is trip
    assert (trip.time_s, trip.tick) == (0.001, 1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        trip.cause = "other"


def test_old_samples_name_their_devices_without_a_trip(guard):
    never = {"encoder_at_s": -inf, "torque_at_s": -inf, "force_at_s": -inf}
    said = guard.too_old(measured(1.0, **never))
    assert said == ("encoder: no sample yet", "force sensor: no sample yet", "drives: no sample yet")
    young = {"encoder_at_s": 0.996, "torque_at_s": 0.991, "force_at_s": 0.981, "force_status": Status.FAULT}
    assert guard.too_old(measured(1.0, **young)) == ()
    assert guard.tripped is None


@pytest.mark.parametrize(("encoder_age_s", "longest_s"), [(0.005, 0.1), (0.5, 0.5)])
def test_longest_hold_up_is_the_encoder_age_or_a_tenth_of_a_second(encoder_age_s, longest_s):
    limits = LIMITS.model_copy(update={"encoder_age_s": encoder_age_s})
    assert Guard(limits, SAFE_STATE, 2).longest_hold_up_s == longest_s


class TestLimiting:
    @pytest.mark.parametrize(
        ("command", "changes", "dt_s", "sent", "cause"),
        [
            ((0.9, -0.4), {}, DT, [0.9, -0.4], ""),
            ((99.0, 0.0), {}, DT, [1.0, 0.0], ""),
            ((0.0, 99.0), {}, DT, [0.0, 0.5], ""),
            # The rate starts from the measured torque, at most from the limit.
            ((0, 0), {"joint_torque_nm": [8.0, -2.0]}, DT, [7.0, -1.5], ""),
            ((10, 5), {"joint_torque_nm": [99.0, 99.0]}, DT, [10.0, 5.0], ""),
            ((5, 5), {}, 0.0, [0.0, 0.0], ""),  # no time means no change
            *(((1, 1), {}, bad_s, [0.0, 0.0], "time step") for bad_s in (-1e-3, nan, inf)),
            ((1, 1, 1), {}, DT, [0.0, 0.0], "shape (3,), expected (2,)"),
            ((1, 1), {"force_n": 99.0}, DT, [0.0, 0.0], "99 N"),  # nobody has watched it yet
            ((10.5, -99.0), {"joint_torque_nm": [9.9, -4.9]}, DT, [10.0, -5.0], ""),
            ((-1e300, -5.0), {"joint_torque_nm": [10.0, -5.0]}, DT, [9.0, -5.0], ""),
        ],
    )
    def test_command_is_limited_to_what_is_allowed(self, guard, command, changes, dt_s, sent, cause):
        assert limited(guard, torque(*command), measured(**changes), dt_s) == sent
        assert cause in guard.tripped.cause if cause else guard.tripped is None

    def test_rate_is_clipped_from_the_last_command(self, guard):
        sent = [limited(guard, torque(9.0, -9.0), measured(0.001 * tick))[0] for tick in range(12)]
        np.testing.assert_allclose(sent, [1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 9])

    @pytest.mark.parametrize(("pause_s", "sent_nm"), [(0.1, 9.0), (0.101, 1.0), (1.0, 1.0)])
    def test_rate_restarts_from_the_measured_torque_after_a_pause(self, guard, pause_s, sent_nm):
        """An arm that was deactivated for a while carries nothing of what was sent before."""
        for tick in range(-8, 1):
            limited(guard, torque(9, 0), measured(0.001 * tick))
        assert limited(guard, torque(9, 0), measured(pause_s)) == [sent_nm, 0.0]

    @pytest.mark.parametrize("bad", [nan, inf, -inf])
    def test_nonfinite_command_trips_and_is_not_sent(self, guard, bad):
        limited(guard, torque(1, 1), measured(0.0))
        assert limited(guard, torque(0, bad), measured(0.001, joint_velocity_rad_s=[1.0, 0.0])) == [-2.0, 0.0]
        assert f"the controller's torque for joint 2 is {bad}" in guard.tripped.cause

    def test_results_are_immutable(self, guard):
        for wanted in (torque(0, 0), torque(nan, 0)):
            with pytest.raises(ValueError, match="read-only"):
                guard.limit(wanted, measured(), DT).joint_torque_nm[0] = 1.0

    @given(
        st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), min_size=1, max_size=30),
        st.floats(0, 0.01),
    )
    def test_no_command_exceeds_the_limits(self, wanted, dt_s):
        guard, before = Guard(LIMITS, SAFE_STATE, 2), np.zeros(2)
        for tick, pair in enumerate(wanted):
            sent = np.array(limited(guard, torque(*pair), measured(1e-3 * tick), dt_s))
            assert (np.abs(sent) <= LIMITS.torque_nm).all()
            assert (np.abs(sent - before) <= np.array(LIMITS.torque_rate_nm_s) * dt_s + 1e-12).all()
            before = sent
        assert guard.tripped is None


class TestStop:
    """After a trip at 0 s; the torque goes off after 0.05 s."""

    @pytest.fixture
    def tripped(self, guard):
        guard.watch(measured(0.0))
        guard.trip("test")
        return guard

    def stopping(self, guard, time_s, velocity, dt_s=DT, **changes):
        changes = {"joint_velocity_rad_s": velocity} | changes
        return limited(guard, torque(7, 7), measured(time_s, **changes), dt_s)

    @pytest.mark.parametrize(
        ("velocity", "sent"),
        [([1.0, -0.5], [-2.0, 0.5]), ([-1e9, 4.5], [6.0, -4.0])],  # a mad one as the fastest allowed
    )
    def test_guard_brakes_against_the_velocity(self, tripped, velocity, sent):
        assert self.stopping(tripped, 0.001, velocity) == sent

    def test_braking_ignores_the_rate_limit(self, guard):
        limited(guard, torque(0, 0), measured(0.0, joint_torque_nm=[10.0, 0.0]))
        guard.trip("test")
        assert self.stopping(guard, 0.001, [2.0, 0.0], dt_s=1e-6) == [-4.0, 0.0]

    def test_braking_respects_the_torque_limit(self):
        guard = Guard(LIMITS, SafeState(damping_nms_rad=(100.0, 0.0), stop_time_s=0.05), 2)
        guard.watch(measured(0.0))
        guard.trip("test")
        assert self.stopping(guard, 0.001, [2.0, 2.0]) == [-10.0, 0.0]

    def test_torque_is_off_in_time_and_stays_off(self, tripped):
        sent = [self.stopping(tripped, 0.001 * tick, [1.0, 1.0]) for tick in range(1, 61)]
        braked = [any(command) for command in sent]
        assert braked[:49] == [True] * 49
        assert not any(braked[49:])
        assert tripped.finished
        assert self.stopping(tripped, 0.001, [1.0, 1.0]) == [0.0, 0.0]

    @pytest.mark.parametrize(
        "unknown",
        [
            {"encoder_status": Status.FAULT},
            {"encoder_status": Status.SATURATED},
            {"encoder_at_s": -0.01},
            {"encoder_at_s": nan},
            {"velocity": [nan, 1.0]},
            {"velocity": [1.0, inf]},
        ],
        ids=str,
    )
    def test_torque_is_zero_without_a_trusted_velocity(self, tripped, unknown):
        velocity = unknown.get("velocity", [1.0, 1.0])
        changes = {key: value for key, value in unknown.items() if key != "velocity"}
        assert self.stopping(tripped, 0.001, velocity, **changes) == [0.0, 0.0]
        assert not tripped.finished
        assert self.stopping(tripped, 0.002, [1.0, 1.0]) == [-2.0, -1.0]  # the velocity is back

    @pytest.mark.parametrize(
        ("times_s", "dt_s", "brakes"),
        [
            ((0.0, 0.0, 0.0), 0.025, [True, False, False]),  # by its own steps: the clock stands still
            ((0.025, 0.049, 0.05), 1e-6, [True, True, False]),  # by the clock: the steps are too short
        ],
    )
    def test_safe_stop_ends_on_time(self, tripped, times_s, dt_s, brakes):
        assert [any(self.stopping(tripped, time_s, [1.0, 1.0], dt_s)) for time_s in times_s] == brakes

    def test_safe_stop_ends_with_a_decreasing_clock(self, tripped):
        for tick in range(1, 60):
            self.stopping(tripped, -0.001 * tick, [1.0, 1.0])
        assert tripped.finished

    @pytest.mark.parametrize(("time_s", "dt_s"), [(nan, DT), (0.001, nan), (0.001, -1.0), (0.001, 0.0)])
    def test_safe_stop_ends_with_invalid_time(self, tripped, time_s, dt_s):
        assert self.stopping(tripped, time_s, [1.0, 1.0], dt_s=dt_s) == [0.0, 0.0]
        assert tripped.finished

    def test_trip_before_the_first_measurement_gives_no_torque(self, guard):
        guard.trip("no")
        assert self.stopping(guard, 0.0, [1.0, 1.0]) == [0.0, 0.0]
        assert guard.finished
        assert math.isnan(guard.tripped.time_s)
        assert guard.tripped.tick == -1


class TestWeight:
    """A stop that knows what the arm weighs: braked for 0.05 s, lowered for 0.4 s."""

    SAFE = SafeState(damping_nms_rad=(2.0, 1.0), stop_time_s=0.05, lower_time_s=0.4, lower_speed_rad_s=0.5)

    def stop(self, weight=(4.0, -1.0), velocity=lambda tick: [0.0, 0.0], ticks=460, **changes):
        """Torques of the ticks from 1 on after a trip at 0 s, and the guard."""
        model = weight if callable(weight) else lambda position: np.array(weight)
        guard = Guard(LIMITS, self.SAFE, 2, model)
        guard.watch(measured(0.0))
        guard.trip("test")
        sent = [
            limited(
                guard, torque(7, 7), measured(0.001 * tick, joint_velocity_rad_s=velocity(tick), **changes)
            )
            for tick in range(1, ticks + 1)
        ]
        return np.array(sent), guard

    def test_arm_is_held_up_while_braking(self):
        sent, _ = self.stop(velocity=lambda tick: [1.0, -0.5], ticks=49)
        assert sent == pytest.approx(np.tile([4.0 - 2.0, -1.0 + 0.5], (49, 1)))

    def test_supported_arm_is_lowered_within_the_time(self):
        sent, guard = self.stop()
        share = sent[:, 0] / 4.0
        assert (np.diff(share) <= 1e-12).all()
        assert np.abs(np.diff(share)).max() < 0.02  # no jump, not even when the torque goes off
        assert sent[:, 1] == pytest.approx(-share)
        assert share[250] < 0.05
        assert share[-20:] == pytest.approx(0.0)
        assert guard.finished

    def test_free_arm_sinks_at_the_set_speed(self):
        """A mass of 1 kg m^2 on the first joint that weighs 4 N m and is damped with 2 N m s/rad."""
        speed, speeds = 0.0, []
        guard = Guard(
            LIMITS, self.SAFE.model_copy(update={"lower_time_s": 8.0}), 2, lambda _: np.array([4.0, 0])
        )
        guard.watch(measured(0.0))
        guard.trip("test")
        for tick in range(1, 6000):
            sent = limited(guard, torque(0, 0), measured(0.001 * tick, joint_velocity_rad_s=[speed, 0.0]))
            speed += DT * (sent[0] - 4.0)
            speeds.append(speed)
        assert speeds[45] == 0.0
        assert min(speeds) > -0.75
        assert speeds[-500:] == pytest.approx([-0.5] * 500, abs=0.01)

    def test_support_fades_in_the_last_quarter_of_the_time(self):
        """It sinks at the set speed, and would be held up for ever."""
        weight = np.array([4.0, -1.0])
        velocity = -0.5 * weight / np.linalg.norm(weight)
        sent, guard = self.stop(velocity=lambda tick: velocity)
        share = (sent + np.array([2.0, 1.0]) * velocity)[:449] / weight
        fades = np.clip((0.45 - 0.001 * np.arange(1, 450)) / 0.1, 0.0, 1.0)
        assert share == pytest.approx(np.tile(fades[:, None], 2), abs=1e-6)
        assert guard.finished

    def test_arm_is_held_up_to_the_end_of_braking(self):
        guard = Guard(LIMITS, self.SAFE, 2, lambda _: np.array([4.0, -1.0]))
        guard.watch(measured(0.0))
        guard.trip("test")
        held = [limited(guard, torque(0, 0), measured(0.025 * k), 0.025)[0] for k in (1, 2, 3)]
        assert held == pytest.approx([4.0, 4.0, 4.0 * (1.0 - 0.025 / 0.2)])

    def test_arm_heavier_than_its_model_gets_more_support_within_the_torque_limit(self):
        sent, _ = self.stop(velocity=lambda tick: [-2.0, 0.0], ticks=200)
        assert sent[-1][0] == pytest.approx(1.25 * 4.0 + 2.0 * 2.0)
        sent, _ = self.stop(weight=(99.0, -99.0), ticks=40)
        assert sent == pytest.approx(np.tile([10.0, -5.0], (40, 1)))

    @pytest.mark.parametrize(
        "model",
        [
            lambda position: np.array([nan, 1.0]),
            lambda position: np.array([1.0, inf]),
            lambda position: np.array([1.0]),
            lambda position: None,
            lambda position: 1 / 0,
        ],
    )
    def test_failing_gravity_model_still_brakes_for_as_long(self, model):
        sent, guard = self.stop(weight=model, velocity=lambda tick: [1.0, -0.5])
        assert sent[:448] == pytest.approx(np.tile([-2.0, 0.5], (448, 1)))
        assert not sent[-5:].any()
        assert guard.finished

    def test_failed_gravity_model_is_not_called_again(self):
        calls = []
        self.stop(weight=lambda position: calls.append(1) or np.array([nan, nan]))
        assert len(calls) == 1
        guard = Guard(LIMITS, self.SAFE, 2, lambda position: calls.append(1) or np.zeros(2))
        for tick in range(20):
            limited(guard, torque(1, 1), measured(0.001 * tick))
        assert len(calls) == 1  # nor is any while the arm is not being stopped

    @pytest.mark.parametrize(
        "unknown",
        [{"encoder_status": Status.FAULT}, {"encoder_at_s": -0.1}, {"joint_position_rad": [nan, 0.0]}],
        ids=str,
    )
    def test_gravity_of_an_unknown_arm_is_not_modeled(self, unknown):
        asked = []
        sent, guard = self.stop(weight=lambda position: asked.append(1) or 4.0 + position, **unknown)
        assert not sent.any()
        assert not asked
        assert guard.finished

    def test_next_stop_starts_with_full_support(self):
        _, guard = self.stop()
        guard.rearm(measured(1.0))
        guard.trip("again")
        assert limited(guard, torque(0, 0), measured(1.001)) == [4.0, -1.0]

    def test_guard_cannot_be_rearmed_while_lowering(self):
        _, guard = self.stop(ticks=200)
        with pytest.raises(SafetyTripError, match="still being stopped"):
            guard.rearm(measured(0.201))


class TestRearm:
    @pytest.fixture
    def stopped(self, guard):
        """Tripped by a force of 25 N at 0 s, torque off since 0.05 s."""
        guard.watch(measured(0.0, force_n=25.0))
        for tick in range(60):
            limited(guard, torque(5, 5), measured(0.001 * tick, force_n=25.0))
        assert guard.finished
        return guard

    @pytest.mark.parametrize(
        ("changes", "cause"), [({"force_n": 25.0}, "the contact force is 25 N"), *WRONG[:-1]], ids=str
    )
    def test_rearm_is_refused_for_the_old_or_any_other_violation(self, stopped, changes, cause):
        with pytest.raises(SafetyTripError, match=rf"not re-armed: .*{cause}"):
            stopped.rearm(measured(1.0, **changes))
        assert "25 N" in stopped.tripped.cause
        assert limited(stopped, torque(5, 5), measured(1.001)) == [0.0, 0.0]

    def test_rearm_is_refused_during_the_stop(self, guard):
        guard.watch(measured(0.0))
        guard.trip("Ctrl-C")
        with pytest.raises(SafetyTripError, match=r"still being stopped \(Ctrl-C\)"):
            guard.rearm(measured(0.02))
        guard.rearm(measured(0.05))  # nobody went on commanding; the time is over all the same
        assert guard.tripped is None

    def test_rearm_starts_from_the_measured_state_and_refuses_an_old_one(self, stopped):
        with pytest.raises(SafetyTripError, match="time went from"):
            stopped.rearm(measured(0.03))
        stopped.rearm(measured(1.0, joint_torque_nm=[2.0, 0.0]))
        assert stopped.tripped is None
        assert not stopped.finished
        assert limited(stopped, torque(9, 0), measured(1.001, joint_torque_nm=[2.0, 0.0])) == [3.0, 0.0]

    def test_rearmed_guard_trips_again(self, stopped):
        stopped.rearm(measured(1.0))
        stopped.watch(measured(1.001, force_n=30.0))
        assert "30 N" in stopped.tripped.cause
        assert not stopped.finished
        assert limited(stopped, torque(9, 0), measured(1.002, joint_velocity_rad_s=[1.0, 0.0])) == [-2.0, 0.0]


def test_runaway_is_caught_and_brought_to_rest():
    """A whole arm, thrown against its limits."""
    robot_file, clock = mock_robot_file(), SimulatedClock()
    robot = build_mock_robot(clock)
    guard, plant = Guard(robot_file.limits, robot_file.safe_state, 3), mock_bus(robot).plant
    robot.configure()
    robot.activate()
    fastest = 0.0
    for tick in range(1, 600):
        clock.sleep_until(tick * DT)
        measurement = robot.read(tick * DT + 0.5 * DT)
        guard.watch(measurement)
        robot.write(guard.limit(torque(4.0, 0.0, 0.0), measurement, DT), clock.now_s() + DT)
        fastest = max(fastest, np.abs(measurement.joint_velocity_rad_s).max())
    assert "joint 1" in guard.tripped.cause
    assert guard.finished
    assert fastest < 8.5
    assert np.abs(plant.velocity_rad_s).max() < 0.05 * fastest
    assert not plant.torque_nm.any()


def watch_many(guard, count, reading, reference, torque_nm, *, first=0, force_n=lambda k: 0.0, every=1):
    """`count` ticks; each argument gives joint 1's value at tick k. Returns the tick of the trip, or None."""
    for k in range(first, first + count):
        state = {"joint_position_rad": [reading(k - k % every), 0], "joint_torque_nm": [torque_nm(k), 0]}
        state["encoder_at_s"] = (k - k % every) * DT
        guard.watch(measured(k * DT, **state, force_n=force_n(k)), np.array([reference(k), 0.0]))
        if guard.tripped:
            return k
    return None


STEP = 2 * math.pi / 4096
SPEED = 0.5e-3  # rad per tick


def in_steps(position_rad):
    return round(position_rad / STEP) * STEP


@pytest.mark.parametrize("seen", [in_steps, float], ids=["12 bits", "fine"])
def test_frozen_encoder_is_named_before_the_joint_is_far_off(guard, seen):
    def reading(k):
        return seen(SPEED * min(k, 100))

    # The controller answers to the error that it sees: 400 N m/rad.
    tick = watch_many(guard, 200, reading, lambda k: SPEED * k, lambda k: 400 * (SPEED * k - reading(k)))
    assert guard.tripped.cause.startswith("encoder of joint 1: stuck at 0.0")
    assert 100 < tick <= 125
    # Its velocity is nothing to brake against; that of the other joint is.
    frozen = guard.limit(
        torque(1, 1),
        measured(tick * DT + DT, joint_position_rad=[reading(tick), 0], joint_velocity_rad_s=[1.0, 1.0]),
        DT,
    )
    assert frozen.joint_torque_nm.tolist() == [0.0, -1.0]


def test_second_joint_encoder_is_judged_by_its_own_drive():
    """Half of its torque limit of 5 N m makes it stuck, whatever the first joint's drive does."""

    def watch(first_nm, second_nm):
        guard = Guard(LIMITS, SAFE_STATE, 2)
        for k in range(200):
            stuck_rad, reference_rad = SPEED * min(k, 100), SPEED * k
            state = {
                "joint_position_rad": [0.0, stuck_rad],
                "joint_torque_nm": [first_nm * (k > 100), second_nm * (reference_rad - stuck_rad)],
            }
            guard.watch(measured(k * DT, **state), np.array([0.0, reference_rad]))
        return guard.tripped

    assert watch(9.0, 0.0) is None
    assert watch(0.0, 400.0).cause.startswith("encoder of joint 2: stuck at 0.0")


def test_encoder_without_a_step_may_be_a_coarse_one(guard):
    """Nobody knows its steps: a sound one is expected to show a twentieth of the tracking limit."""
    tick = watch_many(guard, 300, lambda k: 0.0, lambda k: SPEED * k / 4, lambda k: 6.0 if k > 5 else 0.0)
    assert guard.tripped.cause.startswith("encoder of joint 1: stuck at 0 rad")
    assert SPEED * tick / 4 == pytest.approx(5e-3, abs=3e-4)


class TestStoppedInItsMotion:
    """A joint that stands still from one sample to the next, on a drive that answers with 150 N m/rad.

    Its torque limit is 10 N m: half of it is reached 33 mrad behind the reference, one tenth at 7 mrad.
    """

    def named(self, guard, reference, at, seen=float, force_n=lambda k: 0.0):
        """The ticks and the angle from the stop to the trip, of a joint that bears a weight and a force."""

        def reading(k):
            return seen(reference(min(k, at)))

        tick = watch_many(
            *(guard, 2000, reading, reference),
            lambda k: 150 * (reference(k) - reading(k)) - 3.0,
            force_n=lambda k: 0.4 + force_n(k),
        )
        assert guard.tripped.cause.startswith("encoder of joint 1: stuck at")
        return tick - at, abs(reference(tick) - reading(tick))

    @pytest.mark.parametrize("seen", [in_steps, float], ids=["12 bits", "fine"])
    @pytest.mark.parametrize(("at", "start_rad"), [(60, 0.0), (407, 0.0), (60, -0.6)])
    def test_fault_is_named_within_the_limit_and_two_ticks(self, guard, seen, at, start_rad):
        ticks, _ = self.named(guard, lambda k: start_rad + SPEED * k, at, seen)
        assert ticks <= 22

    @pytest.mark.parametrize(
        ("limits", "force_n", "ticks"),
        [({}, 0.4, 20), ({"stuck_encoder_s": 0.03}, 0.0, 30)],  # so small a force is not felt
    )
    def test_limit_is_that_of_the_robot_file(self, limits, force_n, ticks):
        guard = Guard(LIMITS.model_copy(update=limits), SAFE_STATE, 2)
        took, _ = self.named(guard, lambda k: SPEED * k, 100, force_n=lambda k: 0.0 if k <= 100 else force_n)
        assert took == ticks

    @pytest.mark.parametrize(
        ("reference", "at", "force_n"),
        [
            (lambda k: SPEED * k, 100, 0.6),  # an object is hit
            (lambda k: SPEED * (k if k <= 200 else 400 - k), 200, 0.0),  # it turns round, or starts again
            (lambda k: SPEED * (k if k <= 200 else max(200, k - 300)), 200, 0.0),
        ],
    )
    def test_blocked_joint_is_given_time(self, guard, reference, at, force_n):
        _, behind_rad = self.named(guard, reference, at, force_n=lambda k: 0.0 if k <= at else force_n)
        assert 0.03 < behind_rad < 0.04

    @pytest.mark.parametrize("slip_rad", [0.007, 0.01])
    def test_slipping_and_sticking_joint_is_no_stuck_encoder(self, guard, slip_rad):
        """A slip in one tick, while the reference creeps on."""

        def reference(k):
            return 0.2 * SPEED * max(0, k - 50)

        def reading(k):
            return 1e-5 * (k % 2) if k < 50 else slip_rad if k >= 150 else 0.0

        tick = watch_many(guard, 600, reading, reference, lambda k: 150 * (reference(k) - reading(k)))
        assert abs(reference(tick) - reading(tick)) > 0.015

    @pytest.mark.parametrize(("rest", "first"), [(100, 291), (50, 241)], ids=["re-armed", "a gap of 46 ms"])
    def test_motion_before_a_stop_or_a_gap_in_the_samples_proves_nothing(self, guard, rest, first):
        def reference(k):
            return SPEED * (k if k <= 195 else max(195, k - rest))

        def reading(k):
            return reference(min(k, 195))

        assert watch_many(guard, 195, reading, reference, lambda k: 0.0) is None
        if rest == 100:
            guard.trip("Ctrl-C")
            guard.rearm(measured(0.29, joint_position_rad=[reading(290), 0]))
        tick = watch_many(
            guard, 200, reading, reference, lambda k: 150 * (reference(k) - reading(k)), first=first
        )
        assert 0.03 < abs(reference(tick) - reading(tick)) < 0.04


def test_suspect_encoder_is_named_by_whatever_stops_the_arm(guard):
    """The joint is so light that its drive answers with next to nothing."""
    tick = watch_many(guard, 400, lambda k: SPEED * min(k, 100), lambda k: SPEED * k, lambda k: 0.0)
    assert tick == 301  # the tracking limit of 0.1 rad
    first, second = guard.tripped.cause.split("; ")
    assert first == "joint 1 is 0.1005 rad off its reference, limit 0.1 rad"
    assert second.startswith("encoder of joint 1: stuck at 0.05 rad (or the joint is jammed)")


@pytest.mark.parametrize(
    ("seen", "speed", "ticks", "suspect"),
    [
        # A hundredth of the tracking limit is 1 mrad; four steps of 12 bits are 6.1 mrad, from tick 96 on.
        *((float, 0.05e-3, ticks, suspect) for ticks, suspect in ((115, False), (124, True))),
        *((in_steps, 0.2e-3, ticks, suspect) for ticks, suspect in ((124, False), (131, True))),
    ],
)
def test_encoder_is_suspect_beyond_a_share_of_the_tracking_limit_and_some_steps(
    guard, seen, speed, ticks, suspect
):
    reading = lambda k: seen(speed * min(k, 100))  # noqa: E731
    assert watch_many(guard, ticks, reading, lambda k: speed * k, lambda k: 0.0) is None
    assert ("encoder of joint 1" in guard.trip("stopped on request").cause) is suspect


STUCK_EDGES = [  # steps that the joint followed before, then motion of the reference, torque and force
    ("four steps of the encoder", (64, 2.0**-7, 9.0, 0.5), False),
    ("more than those", (64, 2.0**-7 + 2.0**-20, 9.0, 0.5), True),
    ("half the torque limit", (64, 2.0**-6, 5.0, 0.5), False),
    ("more than half", (64, 2.0**-6, 5.01, 0.5), True),
    ("a joint that followed by four steps", (4, 2.0**-6, 2.0, 0.0), False),
    ("one that followed by more", (5, 2.0**-6, 2.0, 0.0), True),
    ("half the earlier speed", (64, 2.0**-5, 2.0, 0.0), False),
    ("more than half of it", (64, 2.0**-5 + 2.0**-12, 2.0, 0.0), True),
]


@pytest.mark.parametrize(
    ("steps", "moved_rad", "torque_nm", "force_n", "stuck"),
    [(*then, stuck) for _, then, stuck in STUCK_EDGES],
    ids=[edge[0] for edge in STUCK_EDGES],
)
def test_stuck_encoder_is_proven_beyond_each_threshold(steps, moved_rad, torque_nm, force_n, stuck):
    """In numbers that floats hold exactly: steps of 2^-9 rad, 2^-10 s from tick to tick."""
    check = StuckEncoders(LIMITS.model_copy(update={"stuck_encoder_s": 2.0**-5}))
    for k in range(120):
        followed_rad, is_stuck = 2.0**-9 * max(min(k, 64) - 64 + steps, 0), k > 64
        state = {"joint_position_rad": [followed_rad, 0], "joint_torque_nm": [torque_nm * is_stuck, 0]}
        measurement = measured(k * 2.0**-10, **state, force_n=force_n * is_stuck)
        if check.problem(measurement, np.array([followed_rad + moved_rad * is_stuck, 0.0])):
            assert (stuck, k) == (True, 64 + 32)
            return
    assert not stuck


def test_suspect_encoder_keeps_the_gravity_support():
    """Friction makes sound encoders suspect: the stop holds the arm up, and brakes what moves again."""
    guard = Guard(LIMITS, SAFE_STATE, 2, lambda _position_rad: np.array([4.0, -1.0]))
    assert watch_many(guard, 150, lambda k: SPEED * min(k, 100), lambda k: SPEED * k, lambda k: 0.0) is None
    assert "encoder of joint 1" in guard.trip("stopped on request").cause

    def stopping(k, position_rad):
        state = {"joint_position_rad": [position_rad, 0], "joint_velocity_rad_s": [1.0, 1.0]}
        return limited(guard, torque(0, 0), measured(k * DT, **state))

    assert stopping(150, SPEED * 100) == [4.0, -2.0]
    assert stopping(151, SPEED * 101) == [2.0, -2.0]
    assert stopping(152, SPEED * 101) == [2.0, -2.0]


def test_moving_encoder_is_no_longer_suspect(guard):
    assert watch_many(guard, 150, lambda k: SPEED * min(k, 100), lambda k: SPEED * k, lambda k: 0.0) is None
    assert watch_many(guard, 10, lambda k: SPEED * k, lambda k: SPEED * k, lambda k: 0.0, first=150) is None
    assert guard.trip("stopped on request").cause == "stopped on request"


def test_suspicion_ends_with_the_stop(guard):
    assert watch_many(guard, 150, lambda k: SPEED * min(k, 100), lambda k: SPEED * k, lambda k: 0.0) is None
    assert "encoder of joint 1" in guard.trip("stopped on request").cause
    guard.rearm(measured(0.3, joint_position_rad=[0.05, 0.0]))
    assert guard.trip("stopped on request").cause == "stopped on request"


def sticking(k):
    """Up to 8 mrad behind a creeping reference; it then breaks loose and is held again."""
    return in_steps(8e-3 * (k // 320))


@pytest.mark.parametrize(
    ("ticks", "reading", "reference", "torque_nm"),
    [
        (500, lambda k: 0.3, lambda k: 0.3, lambda k: 5.0 * math.sin(k)),
        (5000, sticking, lambda k: 25e-6 * k, lambda k: 30 * (25e-6 * k - sticking(k))),
        # A fifth of the samples are new, and of those most show no new step.
        (5000, lambda k: in_steps(50e-6 * (k - k % 5)), lambda k: 50e-6 * k, lambda k: 0.9),
        (300, lambda k: 3e-3 * (k - k % 15), lambda k: 3e-3 * k, lambda k: 0.5 * (k % 15)),
    ],
    ids=["at rest", "sticking", "slow and coarse", "briefly frozen"],
)
def test_equal_readings_of_a_sound_encoder_are_no_fault(guard, ticks, reading, reference, torque_nm):
    assert watch_many(guard, ticks, reading, reference, torque_nm) is None


def test_reversal_against_gear_friction_is_no_stuck_encoder(guard):
    """A fifth of the torque limit, as in an arm with strong gears that is made gentle by its limits."""

    def swing(k):
        return 0.1 * math.sin(2 * math.pi * k / 2000)

    def reading(k):
        held = 500 + 1000 * ((k - 500) // 1000) if k >= 500 else None  # where it turned round last
        return swing(held) if held is not None and k - held < 90 else swing(k)

    def torque_nm(k):
        since = (k - 500) % 1000 if k >= 500 else 1000
        way = -1.0 if k >= 500 and (k - 500) // 1000 % 2 == 0 else 1.0
        return 2.0 * way * min(since / 45 - 1.0, 1.0)

    assert watch_many(guard, 6000, reading, swing, torque_nm) is None


def test_few_encoder_samples_prove_nothing():
    """The fifth equal one comes 20 ms after the first, however short the limit is."""
    guard = Guard(LIMITS.model_copy(update={"stuck_encoder_s": 0.01}), SAFE_STATE, 2)

    def reference(k):
        """At first so slowly that the steps of the encoder are known to be small."""
        return SPEED * (0.1 * k if k < 50 else k - 45)

    def reading(k):
        return reference(min(k, 100))

    def torque_nm(k):
        return 1000 * (reference(k) - reading(k))

    assert watch_many(guard, 200, reading, reference, torque_nm, every=5) == 120
    assert "encoder of joint 1: stuck" in guard.tripped.cause


def test_old_samples_are_not_stuck(guard):
    """The age limit, not this check, says how long a sample may be acted on."""
    for k in range(1, 6):
        old = measured(k * DT, encoder_at_s=DT, joint_torque_nm=[2.0 * k, 0])
        guard.watch(old, np.array([0.01 * k, 0.0]))
    assert guard.tripped is None
