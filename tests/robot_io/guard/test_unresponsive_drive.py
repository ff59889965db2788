"""Detection of an unresponsive drive, without false alarms for inaccurate torque readings."""

import math
from collections import deque

import numpy as np
import pytest

from palpate.robot_io.guard import Guard, Limits, SafeState
from palpate.robot_io.guard.plausibility import UnresponsiveDrives
from palpate.robot_io.types import Command, Measurement, Status

DT = 1e-3
LIMITS = Limits(
    torque_nm=(37.0, 18.0),
    torque_rate_nm_s=(1e6, 1e6),
    position_min_rad=(-3.0, -3.0),
    position_max_rad=(3.0, 3.0),
    velocity_rad_s=(6.0, 6.0),
    force_n=60.0,
    tracking_rad=(0.1, 0.1),
    encoder_age_s=0.005,
    torque_age_s=0.01,
    force_age_s=0.01,
)
OFTEN = 1  # ticks from one sample of the torques to the next


def measured(time_s, torque_nm, *, at_s=None, saturated=()):
    at_s = time_s if at_s is None else at_s
    zeros = np.zeros(2)
    torques = np.array(torque_nm, float)
    status = Status.SATURATED if any(saturated) else Status.OK
    rest = {"torque_status": status, "torque_saturated": saturated}
    return Measurement(time_s, zeros, zeros, torques, 0.0, time_s, at_s, time_s, **rest)


def gravity(k):
    """What an arm is sent that holds its weight, presses at 1.0 s and comes off at 2.0 s, twice."""
    phase = (k * DT) % 2.0
    pressed = min(max((phase - 1.0) / 0.08, 0.0), 1.0) - min(max((phase - 1.9) / 0.05, 0.0), 1.0)
    return 2.1 - 2.6 * pressed + 0.1 * math.sin(0.9 * k)


class HealthyDrive:
    """A drive as others are: what was sent, through everything that may be wrong with its reading."""

    def __init__(
        self, seed=0, *, gain=1.0, bias=0.0, noise=0.0, step=0.0, late=1, lag_s=0.0, most=99.0, **wear
    ):
        self._random = np.random.default_rng(seed)
        self._gain, self._bias, self._noise, self._step = gain, bias, noise, step
        self._late = deque([0.0] * late)
        self._lag_s, self._most, self._follows = lag_s, most, 0.0
        self._drift, self._dead = wear.get("drift", 0.0), wear.get("dead", 0.0)

    def show(self, k, sent_nm):
        self._late.append(sent_nm)
        self._follows += (self._late.popleft() - self._follows) * DT / (DT + self._lag_s)
        value = self._gain * self._follows
        value -= min(max(value, -self._dead), self._dead)
        value += self._bias + self._drift * k * DT + self._noise * self._random.standard_normal()
        value = min(max(value, -self._most), self._most)
        return round(value / self._step) * self._step if self._step else value


def deaf(since, *, until=math.inf, turns=0.0, **wear):
    """What a drive shows that exerts nothing between two ticks, or what was sent times `turns`."""
    drive = HealthyDrive(**({"noise": 0.01} | wear))
    return lambda k, sent: drive.show(k, turns * sent if since <= k < until else sent)


def ticks_until_named(check, show, sent=gravity, *, first=0, count=4000, every=OFTEN):
    """The tick at which joint 1 is named and what is said, or None; joint 2 is sent nothing and shows it."""
    shown, at_s = 0.0, 0.0
    for k in range(first, first + count):
        now = show(k, sent(k))
        if k % every == 0:
            shown, at_s = now, k * DT
        said = check.problem(measured(k * DT, [shown, 0.0], at_s=at_s))
        if said:
            return k, said.text
        check.sent(k * DT, [sent(k), 0.0])
    return None


WEAR = {
    "good": {"noise": 0.01, "step": 0.002},
    "weak constant": {"gain": 0.6, "noise": 0.01},
    "strong constant": {"gain": 3.0, "noise": 0.01},
    "zero off": {"bias": -2.0, "noise": 0.01},
    "zero a little off": {"bias": -0.5, "noise": 0.01},
    "zero off, other way": {"bias": 2.0, "noise": 0.01},
    "zero drifts": {"drift": -0.4, "noise": 0.01},
    "much noise": {"noise": 1.5},
    "coarse": {"step": 1.7, "noise": 0.01},
    "noiseless and coarse": {"step": 1.0},
    "noiseless and very coarse": {"step": 0.05 * 37.0},
    "noiseless, coarse, weak": {"step": 1.0, "gain": 0.6},
    "noiseless, coarse, zero off": {"step": 1.0, "bias": -0.5},
    "late": {"late": 15, "noise": 0.01},
    "very late": {"late": 90, "noise": 0.01},
    "follows slowly": {"lag_s": 0.02, "noise": 0.01},
    "follows very slowly": {"lag_s": 0.06, "noise": 0.01},
    "saturated": {"most": 0.42, "noise": 0.01},
    "dead band": {"dead": 0.6, "noise": 0.01},
    "shows nothing at all": {"gain": 0.0},
}


@pytest.mark.parametrize(("seed", "every"), [(0, 1), (1, 4)])  # ticks from sample to sample
@pytest.mark.parametrize("wear", WEAR)
def test_drive_with_inaccurate_torque_reading_is_not_reported(wear, seed, every):
    drive = HealthyDrive(seed, **WEAR[wear])
    assert ticks_until_named(UnresponsiveDrives(LIMITS), drive.show, every=every) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("wear", "before_nm", "from_tick", "count"),
    [
        # A constant offset is learned first.
        *((wear, 5.0, 0, 3000) for wear in ({"bias": -3.5}, {"drift": -2.0}, {"bias": 3.5})),
        *((wear, 5.0, 0, 3000) for wear in ({"drift": 2.0}, {"gain": 0.52})),
        *(({"late": 90}, 1.0, 300 + phase, 600) for phase in range(0, 100, 20)),  # a reading after a jump
    ],
    ids=str,
)
def test_constant_offset_and_late_reading_are_not_reported(wear, before_nm, from_tick, count, side):
    drive, after_nm = HealthyDrive(noise=0.01, **wear), 6.0 if from_tick else before_nm
    sent = lambda k: side * (before_nm if k < from_tick else after_nm)  # noqa: E731
    assert ticks_until_named(UnresponsiveDrives(LIMITS), drive.show, sent, count=count) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    "wear",
    [
        *({"most": 12.0}, {"most": 12.0, "gain": 3.0}, {"dead": 0.05 * 37.0}, {"step": 0.05 * 37.0}),
        *({"dead": 1.0, "step": 1.0, "gain": 0.6}, {"gain": 0.0}, {"late": 90}, {"lag_s": 0.06}),
    ],
    ids=str,
)
@pytest.mark.parametrize(("mean_nm", "swing_nm"), [(12.0, 10.0), (0.0, 4.0), (5.0, 0.0)])
def test_constant_reading_of_a_working_drive_is_not_reported(wear, mean_nm, swing_nm, side):
    """Saturated, in its dead band, between two steps, or at rest."""
    if wear.get("gain") == 0.0:
        mean_nm = 0.0 if swing_nm else mean_nm
    drive = HealthyDrive(**wear)
    sent = lambda k: side * (mean_nm + swing_nm * math.sin(3.0 * k * DT))  # noqa: E731
    assert ticks_until_named(UnresponsiveDrives(LIMITS), drive.show, sent) is None


SMALL_NM = 4.0  # limit of a small drive
SMALL_WEAR = {
    "dead band": {"dead": 0.05 * SMALL_NM},
    "zero off": {"bias": -0.05 * SMALL_NM},
    "weak, dead band": {"gain": 0.6, "dead": 0.02 * SMALL_NM},
}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wear", SMALL_WEAR)
def test_small_drive_with_torque_deadband_is_not_reported(wear, seed):
    """A twentieth of the torque limit is a few steps of current where an arm is made gentle by its limit."""
    limits = LIMITS.model_copy(update={"torque_nm": (SMALL_NM, SMALL_NM)})
    most_nm = SMALL_NM * (0.05, 0.1, 0.2, 0.3)[seed]
    levels = np.random.default_rng(seed).uniform(-most_nm, most_nm, 21)

    def sent(k):
        """Another torque every 0.4 s, reached within 50 ms."""
        reached = min((k % 400) / 50, 1.0)
        return levels[k // 400] + (levels[k // 400 + 1] - levels[k // 400]) * reached

    drive = HealthyDrive(seed, noise=0.005, **SMALL_WEAR[wear])
    assert ticks_until_named(UnresponsiveDrives(limits), drive.show, sent, count=8000) is None


EDGES = [  # torque limit; what is sent and shown in turn, then what; whether that is missed
    ("half, a hundredth of the limit, two mean jumps", 100, (92, 92), (92, 93), (92, 92), (41, 41), False),
    ("more than that", 100, (92, 92), (92, 93), (92, 92), (40.99, 40.99), True),
    ("two hundredths of the limit", 100, (2, 2), (2, 3), (2, 2), (-9, -9), False),
    ("more than those", 100, (2.01, 2.01), (2, 3), (2.01, 2.01), (-9, -9), True),
    ("a tenth of the limit, never shown before", 100, (0, 0), (0, 1), (10, 10), (0, 1), True),
    ("less than a tenth", 100, (0, 0), (0, 1), (9.99, 9.99), (0, 1), False),
    ("four fifths of what was shown", 200, (10, 15), (5.5, 4.5), (12, 12), (-5, -6), True),
    ("less than four fifths", 200, (10, 15), (5.5, 4.5), (11.99, 11.99), (-5, -6), False),
    ("of what was not shown clearly", 200, (10, 15), (5.49, 4.49), (12, 12), (-5, -6), False),
    ("of what was shown in passing", 200, (10, 15.01), (5.5, 4.5), (12.01, 12.01), (-5, -6), False),
]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("limit_nm", "sent", "shown", "then_sent", "then_shown", "missed"),
    [row[1:] for row in EDGES],
    ids=[row[0] for row in EDGES],
)
def test_missing_share_is_limited_as_documented(limit_nm, sent, shown, then_sent, then_shown, missed, side):
    """Each in numbers that floats hold exactly: 1 N m up and down is a mean jump of 1 N m."""
    named = ticks_until_named(
        UnresponsiveDrives(LIMITS.model_copy(update={"torque_nm": (limit_nm, limit_nm)})),
        lambda k, _: side * (shown if k <= 500 else then_shown)[k % 2],
        lambda k: side * (sent if k <= 500 else then_sent)[k % 2],
        count=800,
    )
    assert bool(named) is missed


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("at", [75, 150, 700, 2300])
@pytest.mark.parametrize("wear", ["good", "zero a little off", "late", "follows slowly"])
def test_restarted_drive_is_named_in_time(wear, at, side):
    drive = HealthyDrive(**WEAR[wear])
    off = HealthyDrive(bias=WEAR[wear].get("bias", 0.0), noise=0.01)
    tick, said = ticks_until_named(
        UnresponsiveDrives(LIMITS),
        lambda k, sent: side * (drive.show(k, side * sent) if k < at else off.show(k, 0.0)),
        lambda k: side * gravity(k),
    )
    assert at < tick <= at + 12  # the limit of 10 ms, and two ticks
    assert said.startswith("joint 1: its drive exerts ")
    assert said.endswith("N m was sent; the drive may have restarted, or left its torque mode")


NAMED = {  # changed limits, what is shown, what is sent, ticks a sample; the first and last tick that may be
    "a small torque of one that has shown it": (
        {"torque_nm": (SMALL_NM, SMALL_NM)},
        lambda: deaf(700, noise=0.005),
        lambda k: 0.05 * SMALL_NM,
        1,
        (701, 712),
    ),
    "pushes the other way": ({}, lambda: deaf(300, turns=-1.0), lambda k: 1.0, 1, (300, 312)),
    "a constant that is wrong by a fifth": ({}, lambda: deaf(700, gain=0.8), lambda k: 4.0, 1, (700, 712)),
    "the time of the robot file": (
        {"unresponsive_drive_s": 0.04},
        lambda: deaf(300),
        lambda k: 3.0,
        1,
        (340, 342),
    ),
    "a reading that jumped once, once it has jumped by little seven times": (
        {"torque_nm": (100.0, 100.0)},
        lambda: lambda k, sent: 92.0 if k <= 500 else 25.0 + k % 2,
        lambda k: 92.0,
        1,
        (517, 520),
    ),
    "no torque after one large step, without noise": (
        {},
        lambda: lambda k, sent: sent if k < 500 else 0.0,
        lambda k: 6.0 if k >= 200 else 0.0,
        1,
        (600, 612),  # 0.1 s and the limit of 10 ms
    ),
    **{  # what is sent is excused for up to 0.2 s
        f"a torque that stays at {frozen_nm} N m": (
            {},
            lambda frozen_nm=frozen_nm, since=since: lambda k, sent: sent if k < since else frozen_nm,
            lambda k: 7.0 + 5.5 * math.sin(2e-3 * math.pi * k),
            1,
            (first, first + 210),
        )
        for frozen_nm, since, first in (
            (7.0, 500, 700),  # when 1.85 N m less are sent
            (12.5, 1250, 1622),  # the largest so far, when less than a quarter is sent
        )
    },
    "a constant torque that was sent long ago": (
        {},
        lambda: lambda k, sent: sent if k < 500 else 6.0,
        lambda k: 6.0 if 200 <= k < 900 else -4.0 * (k >= 900),
        1,
        (900, 1112),  # what was sent before excuses it for up to 0.2 s
    ),
    "the fifth of few samples": ({}, lambda: deaf(300), lambda k: 3.0, 8, (304 + 4 * 8,) * 2),
    "noise, and a large torque": ({}, lambda: deaf(300, noise=0.3), lambda k: 3.2, 1, (301, 400)),
    **{  # what was sent before excuses it for a while
        f"next to nothing until {more_at}": (
            {},
            lambda: deaf(300),
            lambda k, more_at=more_at: 0.2 * math.sin(0.05 * k) if k < more_at else 4.0,
            1,
            (more_at + 10, more_at + 212),
        )
        for more_at in (1000, 1050)
    },
}


@pytest.mark.parametrize("case", NAMED)
def test_unresponsive_drive_is_named_once_certain(case):
    changes, shows, sent, every, (first, last) = NAMED[case]
    check = UnresponsiveDrives(LIMITS.model_copy(update=changes))
    tick, _ = ticks_until_named(check, shows(), sent, every=every)
    assert first <= tick <= last


@pytest.mark.parametrize("sent_nm", [-4.5, 0.95])
def test_report_states_sent_and_exerted_torque(sent_nm):
    waves = lambda k: sent_nm * (1.1 if k % 90 < 45 else 1.0)  # noqa: E731
    _, said = ticks_until_named(UnresponsiveDrives(LIMITS), deaf(300, noise=1e-4), waves)
    assert f"0.00 N m although {sent_nm:.2f} N m was sent" in said


@pytest.mark.parametrize(
    ("deaf_from", "sent_from", "named_at"),
    [
        (50, -300, 59),  # 10 ms after it was last obeyed,
        (50, 0, 59),  # also if that is 50 ms after the first command of all
        (1, 10, 210),  # little was sent until 10 ms: that excuses it to the end of the next tenth of a second
    ],
)
def test_detection_time_is_exact_to_the_tick(deaf_from, sent_from, named_at):
    sent = lambda k: 4.0 if k >= sent_from else 0.1  # noqa: E731
    tick, _ = ticks_until_named(
        UnresponsiveDrives(LIMITS), deaf(deaf_from - 1), sent, first=min(sent_from, 0)
    )
    assert tick == named_at


def test_detection_needs_five_samples_after_a_pause():
    check, shows = UnresponsiveDrives(LIMITS), deaf(0)
    assert ticks_until_named(check, shows, lambda k: 4.0, first=-300, count=301) is None
    tick, _ = ticks_until_named(check, shows, lambda k: 4.0, first=100)
    assert tick == 104  # the fifth sample


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_drive_with_one_sided_torque_deadband_is_not_reported(side):
    drive = HealthyDrive(noise=0.01)
    shows = lambda k, sent: drive.show(k, sent if side * sent > 0.0 else 0.0)  # noqa: E731
    turns = lambda k: 2.0 if k % 1000 < 500 else -2.0  # noqa: E731
    assert ticks_until_named(UnresponsiveDrives(LIMITS), shows, turns) is None


def test_single_bad_samples_do_not_add_up():
    drive = HealthyDrive(noise=0.01)
    two = lambda k, sent: drive.show(k, 0.0 if k % 240 in range(100, 116) else sent)  # noqa: E731
    assert ticks_until_named(UnresponsiveDrives(LIMITS), two, lambda k: 3.0, every=8) is None


def test_repeated_torque_sample_reports_no_drive_fault():
    check, drive = UnresponsiveDrives(LIMITS), HealthyDrive(noise=0.01)
    assert ticks_until_named(check, drive.show, lambda k: 3.0, count=300) is None
    for k in range(300, 400):
        assert check.problem(measured(k * DT, [0.0, 0.0], at_s=0.3)) is None
        check.sent(k * DT, [3.0, 0.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("noise_nm", [0.0, 0.01])
@pytest.mark.parametrize(
    ("joint_1", "joint_2", "saturated", "named"),
    [
        (1.0, 1.0, (True, True), None),
        (-1.0, 1.0, (True, True), "joint 1"),
        (1.0, -1.0, (True, True), "joint 2"),
        *((1.0, joint_2, (True, False), "joint 2") for joint_2 in (-1.0, 0.0, 1.0)),
    ],
)
def test_torque_at_the_end_of_its_range_is_a_bound(sign, noise_nm, joint_1, joint_2, saturated, named):
    """Of drives that measure up to 5 N m, a saturated one hid a weak one, a dead one and its own sign."""
    check, problem = UnresponsiveDrives(LIMITS), None
    for k in range(600):
        sent = min(15.0, 0.05 * k)
        read = [min(sent, 5.0)] * 2 if k < 400 else [5.0 * joint_1, 5.0 * joint_2 + noise_nm * (k % 2)]
        bounds = saturated if sent >= 5.0 else ()
        problem = problem or check.problem(measured(k * DT, [sign * nm for nm in read], saturated=bounds))
        check.sent(k * DT, [sign * sent] * 2)
    assert named in problem.text if named else problem is None


def test_without_commands_nothing_is_expected():
    """The drive's own watchdog has let go meanwhile, and it takes some time to come back."""
    check, shows = UnresponsiveDrives(LIMITS), deaf(500, until=531)
    assert ticks_until_named(check, shows, lambda k: 3.0, count=300) is None
    assert ticks_until_named(check, shows, lambda k: 3.0, first=500, count=600) is None
    check = UnresponsiveDrives(LIMITS)
    for k in range(500):
        assert check.problem(measured(k * DT, [0.01 * (k % 3), 0.0])) is None


def test_readings_before_a_pause_prove_nothing_after_it():
    """A drive that is switched on again may show its torque in another way, or not at all."""
    check = UnresponsiveDrives(LIMITS)
    assert ticks_until_named(check, HealthyDrive(noise=0.01).show, count=600) is None
    assert ticks_until_named(check, HealthyDrive(gain=0.0).show, first=701, count=1500) is None


class TestInTheGuard:
    def run(self, guard, first, count, obeys):
        drive = HealthyDrive(noise=0.01)
        for k in range(first, first + count):
            measurement = measured(k * DT, [drive.show(k, 3.0 if obeys(k) else 0.0), 0.0])
            guard.watch(measurement)
            guard.limit(Command(np.array([3.0, 0.0])), measurement, DT)

    def guard(self):
        return Guard(LIMITS, SafeState(damping_nms_rad=(1.0, 1.0), stop_time_s=0.05), 2)

    def test_unresponsive_drive_stops_the_arm(self):
        guard = self.guard()
        self.run(guard, 0, 400, lambda k: k < 300)
        assert "joint 1: its drive exerts" in guard.tripped.cause
        assert 0.3 < guard.tripped.time_s <= 0.312

    def test_monitor_restarts_when_rearmed_at_once(self):
        guard = self.guard()
        self.run(guard, 0, 300, lambda k: True)
        guard.trip("Ctrl-C")
        self.run(guard, 300, 60, lambda k: True)
        assert guard.finished
        guard.rearm(measured(0.361, [0.0, 0.0]))
        self.run(guard, 362, 300, lambda k: k > 390)  # it takes some time to come back
        assert guard.tripped is None
        self.run(guard, 662, 100, lambda k: False)
        assert guard.tripped
