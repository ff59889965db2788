"""The flexible law of each kind explains effects of its kind, and little of others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.estimation.budget.laws import periodic_columns
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.diagnosis.forms import analyze_kinds, error_of_kinds
from palpate.estimation.kinds import Kind
from tests.estimation.presses import NOISE_N, K, kelvin_voigt, maxwell, session
from tests.estimation.searches import PRESS, ROTOR, SWING, searched
from tests.estimation.swings import WEIGHT, late, link_angles, swings


def press(extra):
    """Presses onto a spring and damper with an `extra` force; the object cannot pull, and lets go."""
    return session(4, lambda t, x, v, run: kelvin_voigt(x, v, extra(t, x, v, run)))


def warm():
    """An effort that goes with a temperature, beside what it is on the average."""
    data = swings(1, runs=4)
    swing = np.sin(0.7 * data.time_s)
    return replace(
        data,
        effort=data.effort + 0.4 * (swing**2 - np.mean(swing**2)),
        context={"temperature": 20.0 + 2.0 * swing},
        recorded=frozenset({"temperature"}),
    )


def plastic(t, x, v, run):
    """A dent as deep as a fifth of the deepest indentation so far."""
    deepest = np.concatenate([np.maximum.accumulate(np.maximum(x[run == r], 0.0)) for r in np.unique(run)])
    return -0.2 * K * deepest


GAINS = np.array([0.8, 1.1, 1.25, 0.9])
OF_KIND = {
    Kind.ELASTIC_SHAPE: lambda: press(lambda t, x, v, run: 1.5e6 * x**3),
    Kind.TIME_MEMORY: lambda: press(lambda t, x, v, run: 600.0 * maxwell(t, x, run, 0.3)),
    Kind.CONTACT_GEOMETRY: lambda: press(plastic),
    Kind.DRIFT: lambda: session(4, lambda t, x, v, run: kelvin_voigt(x, v) + 0.3 * (t - t.mean())),
    Kind.RUN_DIFFERENCES: lambda: session(4, lambda t, x, v, run: GAINS[run] * kelvin_voigt(x, v)),
    Kind.RATE_DEPENDENCE: lambda: swings(1, lambda q, v, a: 0.05 * v * np.abs(v)),
    Kind.FRICTION: lambda: swings(1, lambda q, v, a: 0.4 * np.tanh(v / 0.02)),
    Kind.PERIODIC: lambda: swings(1, lambda q, v, a: 0.3 * np.sin(15.0 * q)),
    Kind.SENSOR_DYNAMICS: lambda: swings(1, sensor=late),
    Kind.SENSOR_STATICS: lambda: swings(1, sensor=lambda torque, _: np.clip(torque, -1.0, 1.0), runs=4),
    Kind.RECORDED_CONTEXT: warm,
}


def slow(torque, run):
    """A sensor behind by a first-order lag of 0.1 s, sampled at 250 Hz."""
    parts = (torque[run == number] for number in np.unique(run))
    share = 1.0 - np.exp(-0.004 / 0.1)
    return np.concatenate([lfilter([share], [1.0, share - 1.0], part) for part in parts])


def hysteretic(torque, run):
    """A sensor that stands still for 0.4 N m after each reversal."""
    reading = torque.copy()
    for k in range(1, len(torque)):
        if run[k] == run[k - 1]:
            reading[k] = np.clip(reading[k - 1], torque[k] - 0.2, torque[k] + 0.2)
    return reading


# Laws that bend, and runs that go further, faster or longer than those that told the law.
FURTHER = {
    "a kink below the depth of all runs but one": (
        Kind.ELASTIC_SHAPE,
        lambda: press(lambda t, x, v, run: 2.0 * K * np.maximum(x - 0.004, 0.0)),
    ),
    "friction that differs by direction": (
        Kind.FRICTION,
        lambda: swings(1, lambda q, v, a: np.where(v > 0, 0.5, 0.1) * np.tanh(v / 0.02)),
    ),
    "damping with the square, until the object lets go": (
        Kind.RATE_DEPENDENCE,
        lambda: press(lambda t, x, v, run: 4e3 * v * np.abs(v)),
    ),
    "a dent of more than half of the depth": (
        Kind.CONTACT_GEOMETRY,
        lambda: press(lambda t, x, v, run: 3.0 * plastic(t, x, v, run)),
    ),
    "a slow sensor": (Kind.SENSOR_DYNAMICS, lambda: swings(1, sensor=slow)),
    "a sensor that hangs": (Kind.SENSOR_STATICS, lambda: swings(1, sensor=hysteretic)),
}


@pytest.mark.parametrize("what", FURTHER)
def test_law_describes_its_kind_in_longer_runs(what):
    kind, made = FURTHER[what]
    first = analysed(made()).budget.entries[0]
    assert first.kind is kind
    assert first.sufficient > 0.7


@pytest.mark.parametrize("tau_s", [0.05, 0.13, 0.3])
def test_relaxation_law_describes_any_time_constant(tau_s, whole_budget):
    """Six constants over these runs would leave up to 30 times the noise."""
    data = press(lambda t, x, v, run: 6000.0 * maxwell(t, x, run, tau_s))
    error = error_of_kinds(searched(data, base=PRESS).start)
    assert error.mean_square() > 1000.0 * NOISE_N**2
    assert error.mean_square(frozenset({Kind.TIME_MEMORY})) < 5.0 * NOISE_N**2


@pytest.mark.parametrize("is_inside", [True, False])
def test_friction_law_acts_inside_an_object_that_lets_go_or_on_the_sides_of_the_tool(is_inside):
    """On return, the friction lifts an object that cannot pull off the tool; at its sides it pulls."""

    def friction(v):
        return 1.5 * np.tanh(v / 1e-3)

    def at_the_sides(t, x, v, run):
        return kelvin_voigt(x, v) + friction(v) * (x > 0.0)

    data = press(lambda t, x, v, run: friction(v)) if is_inside else session(4, at_the_sides)
    error = error_of_kinds(searched(data, base=PRESS).start)
    assert error.mean_square() > 300.0 * NOISE_N**2
    assert error.mean_square(frozenset({Kind.FRICTION})) < 4.0 * NOISE_N**2


def rectangles(sensor, runs=5, seconds=3.0, rate_hz=250.0):
    """A rotor under rectangles of torque, 0.1 s to 0.3 s each, read by `sensor(torque, run)`."""
    rng, step = np.random.default_rng(4), 1.0 / rate_hz
    length = int(seconds * rate_hz)
    torque = np.concatenate(
        [
            np.repeat(rng.choice([-1.0, 0.0, 1.0], 200), rng.integers(25, 75, 200))[:length]
            for _ in range(runs)
        ]
    )
    run = np.repeat(np.arange(runs), length)
    position, velocity, acceleration = np.zeros((3, len(torque)))
    for k in range(len(torque)):
        last = k - 1 if k % length else None
        velocity[k] = 0.0 if last is None else velocity[last] + step * acceleration[last]
        position[k] = 0.0 if last is None else position[last] + step * velocity[last]
        acceleration[k] = (torque[k] - 0.3 * velocity[k]) / 0.05
    time_s = np.tile(step * np.arange(length), runs) + 2.0 * seconds * run
    effort = sensor(torque, run) + rng.normal(0.0, 0.02, len(torque))
    blocks = np.full(len(torque), -1)
    motion = (position, velocity, acceleration)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, *motion, effort, run, blocks)


def test_sensor_dynamics_law_corrects_a_model_bent_by_a_delay():
    """A delay of 0.1 s makes an inertia vanish; what comes late is not what the base model predicts."""
    partial = analyze_kinds(searched(rectangles(lambda torque, run: late(torque, run, 25)), base=ROTOR))
    assert partial.search.start.solution.parameters["inertia.m"] < 0.005  # of 0.05
    first = partial.budget.entries[0]
    assert (first.kind, first.share > 0.8) == (Kind.SENSOR_DYNAMICS, True)


def analysed(data):
    return analyze_kinds(searched(data, base=PRESS if data.name == "contact" else SWING))


def test_drift_is_identified_with_epoch_times():
    data = OF_KIND[Kind.DRIFT]()
    budget = analysed(replace(data, time_s=data.time_s + 1.7e9)).budget
    assert (budget.kinds[0], budget.entries[0].share > 0.8) == (Kind.DRIFT, True)


@pytest.mark.parametrize("kind", OF_KIND)
def test_hidden_kind_has_the_largest_share(kind, whole_budget):
    budget = analysed(OF_KIND[kind]()).budget
    first, *others = budget.entries
    assert first.kind is kind
    assert first.share > 0.8
    assert all(entry.share < 0.1 for entry in others)
    assert sum(entry.share for entry in budget.entries) + budget.unexplained == pytest.approx(1.0)
    assert first.necessary <= first.sufficient + 0.02
    assert first.interval[0] <= first.share <= first.interval[1]


@pytest.mark.parametrize("data", [lambda: swings(2), lambda: session(3)])
def test_no_kind_has_a_share_without_hidden_effects(data, whole_budget):
    assert sum(entry.share for entry in analysed(data()).budget.entries) < 0.05


def test_two_kinds_share_the_error_by_their_energies(whole_budget):
    both = lambda q, v, a: 0.4 * np.tanh(v / 0.02) + 0.3 * np.sin(15.0 * q)  # noqa: E731
    alone = [
        searched(swings(1, law)).start.held_out_mean_square
        for law in (lambda q, v, a: 0.4 * np.tanh(v / 0.02), lambda q, v, a: 0.3 * np.sin(15.0 * q))
    ]
    shares = {entry.kind: entry.share for entry in analysed(swings(1, both)).budget.entries}
    assert shares.keys() == {Kind.FRICTION, Kind.PERIODIC}
    assert shares[Kind.FRICTION] == pytest.approx(alone[0] / sum(alone), abs=0.05)


def test_waves_per_turn_are_identified_with_their_amplitudes():
    """Five families over one turn, as of a motor's cogging; their common wave is one a turn."""
    amplitudes = {7: 1.0, 12: 0.5, 14: 0.8, 28: 0.3, 36: 0.6}
    rng = np.random.default_rng(0)
    angle = np.linspace(0.0, 2.0 * np.pi, 3000)
    phases = {wave: rng.uniform(0.0, 6.0) for wave in amplitudes}
    signal = sum(size * np.sin(wave * angle + phases[wave]) for wave, size in amplitudes.items())
    noisy = signal + 0.05 * rng.standard_normal(len(angle))
    columns = periodic_columns(angle, noisy, is_angle=True)
    coefficients = np.linalg.lstsq(columns, noisy, rcond=None)[0].reshape(-1, 2)
    waves = [round(float(np.mean(np.diff(np.unwrap(np.arctan2(s, c))) / np.diff(angle)))) for s, c in
             columns.T.reshape(-1, 2, len(angle))]  # fmt: skip
    found = dict(zip(waves, np.hypot(*coefficients.T), strict=True))
    assert found == pytest.approx(amplitudes, abs=0.01)


def test_law_uses_only_its_own_signals():
    """A press that stands still has no rate, and the law of the rate no columns that differ from zero."""
    search = searched(session(3), base=PRESS)
    problem = search.start.problem
    still = replace(problem.blocked.data, velocity=0.0 * problem.blocked.data.velocity)
    problem = replace(problem, blocked=replace(problem.blocked, data=still))
    laws = error_of_kinds(replace(search.start, problem=problem)).laws
    (rate,) = (law for law in laws if law.kinds == {Kind.RATE_DEPENDENCE})
    assert not rate.columns.any()
    assert all(np.isfinite(law.columns).all() for law in laws)
    assert all(len(law.nonnegative) == law.columns.shape[1] for law in laws)


def test_friction_law_describes_a_link_that_lags_behind_its_motor():
    """The weight acts at the angle of the link, which rests until the motor has crossed the play."""

    data = swings(1, lambda q, v, a: WEIGHT * (np.sin(link_angles(q, 0.1)) - np.sin(q)))
    first = analysed(data).budget.entries[0]
    assert (first.kind, first.share > 0.8) == (Kind.FRICTION, True)


def test_slow_motions_at_distant_poses_have_laws():
    """The time scale is that of the motion within runs; poses of the runs do not count."""
    t, run = np.tile(np.arange(0.0, 5.0, 0.01), 20), np.repeat(np.arange(20), 500)
    q, v = 0.1 * run + 1e-3 * np.sin(t), 1e-3 * np.cos(t)
    noise = np.random.default_rng(1).normal(0.0, 0.01, len(t))
    effort = np.sin(q) + 30.0 * v + noise
    data = ChannelData("axis", ChannelKind.REVOLUTE, t, q, v, -1e-3 * np.sin(t), effort, run, run * 0 - 1)
    assert data.time_scale == pytest.approx(1.0, rel=0.2)
    assert np.isfinite(analysed(replace(data, name="joint_1")).budget.base)
    resting = replace(data, position=np.full(len(t), 0.1), velocity=0.0 * v, acceleration=0.0 * v)
    assert resting.time_scale == 1.0


@pytest.mark.parametrize("lag_s", [0.03, 0.06, 0.12, 0.25])
def test_law_of_a_slow_sensor_covers_all_lags_of_a_contact(lag_s):
    data = press(lambda t, x, v, run: 0.0 * x)
    share = 1.0 / (1.0 + 500.0 * lag_s)  # of a new reading, at 500 Hz
    parts = [data.effort[data.run == number] for number in np.unique(data.run)]
    late = np.concatenate([lfilter([share], [1.0, share - 1.0], part) for part in parts])
    noise = np.random.default_rng(3).normal(0.0, NOISE_N, len(late))
    first = analysed(replace(data, effort=late + noise)).budget.entries[0]
    assert (first.kind, first.share > 0.9) == (Kind.SENSOR_DYNAMICS, True)
