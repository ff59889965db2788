"""Effects find a truth that was simulated by other means: equations of motion, quadrature, loops."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.special import beta, betainc

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from palpate.estimation.signals.periodicity import harmonics
from tests.estimation.recover import channel, recover
from tests.estimation.swings import swings

CONTACT, REVOLUTE = ChannelKind.CONTACT, ChannelKind.REVOLUTE
NOISE = 1e-3  # of the effort's size


@dataclass(frozen=True)
class RecoveryCase:
    """Data with a known truth."""

    data: ChannelData  # without noise
    base: tuple[str, ...]  # effects of the model beside the one that is looked for
    truth: dict  # parameters of the effect or "effect.parameter"; with powers of length and effort, or 0, 0
    within: float = 0.02  # share of the truth by which each may be off
    left: float = 5 * NOISE  # share of the effort's size that may be left
    of_time: bool = False  # the length is that of the time


def press(deepest, ramps_s=(0.5, 5.0), hold_s=30.0):
    """Ramps and holds, a run each, sampled evenly in the ramp and logarithmically in the hold."""
    for ramp_s in ramps_s:
        t = np.concatenate([np.linspace(0, ramp_s, 120), ramp_s + np.geomspace(1e-3, hold_s, 80)])
        yield t, np.minimum(t / ramp_s, 1.0) * deepest, ramp_s


def swing(count=4000, step_s=2e-3):
    """Time, angle and speed of a joint that swings at two frequencies and rests for a while."""
    t = np.arange(count) * step_s
    clock = np.minimum(t, 3.0) + np.maximum(t - 4.0, 0.0)  # stands still from 3 to 4 s
    moving = (t < 3.0) | (t > 4.0)
    q = 0.8 * np.sin(2.2 * clock) + 0.3 * np.sin(5.1 * clock)
    return t, q, moving * (1.76 * np.cos(2.2 * clock) + 1.53 * np.cos(5.1 * clock))


def state(change, at, rtol=1e-8, **how):
    """A state that begins at zero, by its equation."""
    return solve_ivp(change, (0, at[-1]), [0.0], t_eval=at, rtol=rtol, **how).y[0]


def runs(parts):
    """Concatenated signals of several runs and the run of each sample; all clocks begin at zero."""
    number = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    return [np.concatenate(signal) for signal in zip(*parts, strict=True)], number


def pressed(parts):
    """A contact of several runs of time, depth and force."""
    (t, x, force), run = runs(list(parts))
    return channel(CONTACT, t, x, force, run=run)


def power_law_stiffness():
    modulus, radius = 5e3, 0.01  # a sphere on soft rubber
    k = 4 / 3 * modulus * np.sqrt(radius)
    data = pressed((t, x, k * x**1.5) for t, x, _ in press(0.006))
    return RecoveryCase(data, (), {"n": 1.5, "k": (k, -1.5, 1)}, 0.03)


def exponential_stiffness():
    at_rest, steep = 40.0, 350.0  # dF/dx = E0 + b F
    depth = np.linspace(0.0, 0.008, 300)
    law = state(lambda x, f: at_rest + steep * f, depth, rtol=1e-10, atol=1e-12)
    data = pressed((t, x, np.interp(x, depth, law)) for t, x, _ in press(0.008))
    truth = {"b": (steep, -1, 0), "a": (at_rest / steep, 0, 1), "stiffness.k": (at_rest, -1, 1)}
    return RecoveryCase(data, ("stiffness",), truth, 0.05)


def softening_stiffness():
    stiffest, softest, reach = 3000.0, 500.0, 0.002  # the slope falls from one to the other
    depth = np.linspace(0.0, 0.008, 300)
    law = state(
        lambda x, f: softest + (stiffest - softest) * np.exp(-x / reach), depth, rtol=1e-10, atol=1e-12
    )
    data = pressed((t, x, np.interp(x, depth, law)) for t, x, _ in press(0.008))
    truth = {"d": (reach, 1, 0), "a": ((stiffest - softest) * reach, 0, 1), "stiffness.k": (softest, -1, 1)}
    return RecoveryCase(data, ("stiffness",), truth, 0.05)


def relaxation_spectrum():
    fast, slow, sooner, later = 0.4, 0.25, 0.3, 9.0

    def kernel(t):
        return 1 - fast - slow + fast * np.exp(-t / sooner) + slow * np.exp(-t / later)

    parts = []
    for t, x, ramp_s in press(0.01):
        rate = 0.01 / ramp_s  # E = 3e5 x^2.2
        force = [
            quad(
                lambda s, now=now, rate=rate: kernel(now - s) * 3e5 * 2.2 * (rate * s) ** 1.2 * rate,
                0,
                min(now, ramp_s),
                epsabs=1e-9,
            )[0]
            for now in t
        ]
        parts.append((t, x, np.array(force)))
    truth = {"fast": fast, "slow": slow, "fast_time": sooner, "slow_time": later}
    truth["power_law_stiffness.n"] = 2.2
    return RecoveryCase(pressed(parts), ("power_law_stiffness",), truth, 0.05)


def power_law_relaxation():
    share, alpha, k = 0.6, 0.25, 2e5  # E = k x^2
    parts = []
    for t, x, ramp_s in press(0.01, ramps_s=(0.1, 1.0, 10.0)):
        rate = 0.01 / ramp_s
        done = np.minimum(ramp_s / np.maximum(t, 1e-12), 1.0)  # share of the time since the start in the ramp
        grown = 2 * k * rate**2 * t ** (2 - alpha) * beta(2, 1 - alpha) * betainc(2, 1 - alpha, done)
        parts.append((t, x, (1 - share) * k * x**2 + share * grown))
    truth = {"share": share, "alpha": alpha, "power_law_stiffness.n": 2.0}
    return RecoveryCase(pressed(parts), ("power_law_stiffness",), truth, 0.05)


def stress_relaxation():
    spring, branch, tau = 500.0, 300.0, 1.2
    parts = []
    for t, x, ramp_s in press(0.01):
        rate = 0.01 / ramp_s

        def change(now, force, rate=rate, ramp_s=ramp_s):
            return branch * rate * (now < ramp_s) - force / tau

        parts.append((t, x, spring * x + state(change, t, atol=1e-10, max_step=ramp_s / 20)))
    return RecoveryCase(pressed(parts), ("stiffness",), {"k1": (branch, -1, 1), "tau": tau}, 0.03)


def dahl(path):
    """Dahl's state by its equation in time, for a swing."""
    t, _, v = swing()

    def change(now, z):
        speed = np.interp(now, t, v)
        return (speed - abs(speed) * z) / path

    return state(change, t, max_step=4 * (t[1] - t[0]), rtol=1e-6)


def presliding_friction():
    t, q, v = swing()
    data = channel(REVOLUTE, t, q, 0.4 * v + 1.3 * dahl(0.05), velocity=v)
    return RecoveryCase(data, ("viscous_friction",), {"force": (1.3, 0, 1), "presliding": (0.05, 1, 0)})


def load_dependent_presliding():
    t, q, v = swing()
    load = 3.0 * np.sin(q + 0.4) + 0.5
    torque = load + 0.3 * np.abs(load) * dahl(0.03)
    data = channel(REVOLUTE, t, q, torque, velocity=v, context={"load": load})
    return RecoveryCase(data, ("weight", "bias"), {"mu": 0.3, "presliding": (0.03, 1, 0)})


def wen(rise, across, along, n):
    """Wen's state by his own equation, for a swing."""
    t, _, v = swing()

    def change(now, z):
        speed = np.interp(now, t, v)
        return rise * speed - across * abs(speed) * abs(z) ** (n - 1) * z - along * speed * abs(z) ** n

    return state(change, t, max_step=4 * (t[1] - t[0]), rtol=1e-6)


def bouc_wen_hysteresis():
    t, q, v = swing()
    rise, across, along, n, alpha = 2.0, 30.0, 10.0, 2.0, 1.5
    data = channel(REVOLUTE, t, q, 0.4 * v + alpha * wen(rise, across, along, n), velocity=v)
    most = (rise / (across + along)) ** (1 / n)
    truth = {
        "force": (alpha * most, 0, 1),
        "path": (most / rise, 1, 0),
        "sharpness": n,
        "unloading": 2 * across / (across + along) - 1,
    }
    return RecoveryCase(data, ("viscous_friction",), truth, 0.05)


def loaded_backlash():
    t, q, v = swing()
    load, place, stands = 2.0 * np.sin(1.3 * t) + 0.4 * np.sin(7 * t), 0.0, []
    for now in load:  # a light link that friction holds, and thick oil in the gap slows
        pull = np.sign(now) * max(abs(now) - 0.5, 0.0)
        place = min(max(place + pull / 0.5 * 2e-3, -0.1), 0.1)
        stands.append(place)
    torque = 5.0 * (q - np.array(stands)) + 0.2 * v
    data = channel(REVOLUTE, t, q, torque, velocity=v, context={"load": load})
    truth = {"gap": (0.2, 1, 0), "stiffness.k": (5.0, -1, 1)}
    return RecoveryCase(data, ("stiffness", "viscous_friction"), truth, 0.05, left=0.05)


def delay():
    t = np.arange(3000) * 1e-3
    ahead, omega = t + 0.0004, 2 * np.pi * 60.0  # sixteen samples a period
    q, late = ((1.0 + 0.3 * np.sin(0.01 * omega * at)) * np.sin(omega * at) for at in (t, ahead))
    data = channel(REVOLUTE, t, q, 4.0 * late, velocity=np.zeros(3000))
    truth = {"time": (-0.0004, 1, 0), "stiffness.k": (4.0, 0, 1)}
    return RecoveryCase(data, ("stiffness",), truth, 0.03, of_time=True)


def position_dependent_friction():
    t = np.sort(np.random.default_rng(1).uniform(0, 20, 4000))
    q, v = 9 * np.sin(0.7 * t), 6.3 * np.cos(0.7 * t)
    squeeze = 1.0 + 0.4 * np.cos(q - 0.6)  # of a seal on an eccentric shaft
    torque = 0.2 * v + np.sign(v) * squeeze
    truth = {"cycles": (1.0, -1, 0), "level": (1.0, 0, 1), "cosine": (0.4 * np.cos(0.6), 0, 1)}
    data = channel(REVOLUTE, t, q, torque, velocity=v)
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03)


def torque_ripple():
    t = np.arange(6000) * 1e-3
    q, v = 8 * np.sin(0.9 * t), 7.2 * np.cos(0.9 * t)
    r, angle = 0.6, 12 * q  # a geometric series of harmonics has a closed form
    torque = 0.3 * v + 2.0 * (r * np.cos(angle) - r**2) / (1 - 2 * r * np.cos(angle) + r**2)
    data = channel(REVOLUTE, t, q, torque, velocity=v)
    truth = {f"cosine{end}": (2.0 * r**m, 0, 1) for m, end in ((1, ""), (2, "_2"), (3, "_3"))}
    truth["cycles"] = (12.0, -1, 0)
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03, left=0.05)  # of small waves


def run_ripple():
    rng = np.random.default_rng(2)
    parts = []
    for _ in range(4):
        t = np.arange(400) * 4e-3
        q, v = 1.5 * np.sin(3 * t), 4.5 * np.cos(3 * t)
        parts.append((t, q, v, 0.4 * v + 0.7 * np.sin(18 * q + rng.uniform(0, 2 * np.pi))))
    (t, q, v, torque), run = runs(parts)
    data = channel(REVOLUTE, t, q, torque, velocity=v, run=run)
    return RecoveryCase(data, ("viscous_friction",), {"cycles": (18.0, -1, 0), "share": 1.0})


def run_offset():
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(8):
        t, q, v = (signal[:500] for signal in swing())
        parts.append((t, q, v, 4.0 * q + 0.4 * v + rng.normal(0, 0.8)))
    (t, q, v, torque), run = runs(parts)
    data = channel(REVOLUTE, t, q, torque, velocity=v, run=run)
    truth = {"share": 1.0, "stiffness.k": (4.0, -1, 1)}
    return RecoveryCase(data, ("stiffness", "viscous_friction"), truth)


def run_gain():
    gains = 1.0 + 0.2 * np.random.default_rng(4).standard_normal(10)
    parts = ((t, x, gain * 700.0 * x) for gain in gains for t, x, _ in press(0.01, ramps_s=(1.0,)))
    return RecoveryCase(pressed(parts), ("stiffness",), {"share": 1.0}, 0.05)


def recorded_dependence():
    t, q, v = swing()
    celsius = 25.0 + 8.0 * np.sin(0.4 * t)
    torque = 5.0 * (1 - 0.02 * (celsius - 25.0)) * q
    change = -0.02 * np.std(celsius) / (1 - 0.02 * (np.mean(celsius) - 25.0))
    told = {"context": {"temperature": celsius}, "recorded": frozenset({"temperature"})}
    data = channel(REVOLUTE, t, q, torque, velocity=v, **told)
    return RecoveryCase(data, ("stiffness",), {"change_temperature": change})


def joint_coupling():
    t, q, _ = swing()
    ratio, rotor, drag, dry = 32.0, 4e-5, 8e-4, 0.06  # of the motor behind two joints
    other = 0.9 * np.sin(1.1 * t) + 0.4 * np.cos(3.7 * t)
    speeds = np.column_stack([np.gradient(one, t) for one in (0.2 * other, q, other)])
    rates = np.gradient(speeds, t, axis=0)
    turning = ratio * (speeds[:, 1] + speeds[:, 2])
    motor = rotor * np.gradient(turning, t) + drag * turning + dry * np.tanh(turning / (ratio * 0.01))
    torque = 2.0 * speeds[:, 1] + ratio * motor  # by virtual work
    context = {"joint_velocity": speeds, "joint_acceleration": rates}
    own = {"velocity": speeds[:, 1], "acceleration": rates[:, 1]}
    data = channel(REVOLUTE, t, q, torque, context=context, **own)
    truth = {"ratio": 1.0, "inertia": (rotor * ratio**2, -1, 1), "viscous": (drag * ratio**2, -1, 1)}
    truth["coulomb"] = (dry * ratio, 0, 1)
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03)


def joint_elasticity():
    t = np.arange(5000) * 2e-3
    waves = ((0.5, 3.0), (0.2, 7.0), (0.05, 23.0))
    link, _, a = (
        sum(size * w**order * np.sin(w * t + order * np.pi / 2) for size, w in waves) for order in range(3)
    )
    load = 5.0 * link + 0.2 * a
    motor = link + 2e-3 * load
    told = load + 1e-3 * np.random.default_rng(1).standard_normal(len(t))  # as a model has it from readings
    data = channel(REVOLUTE, t, motor, load, context={"load": told})
    truth = {"compliance": (2e-3, 1, -1), "stiffness.k": (5.0, -1, 1)}
    return RecoveryCase(data, ("stiffness", "inertia"), truth, 0.05)


def tool_compliance():
    t = np.arange(4000) * 1e-3
    spring, damper, tool = 500.0, 20.0, 4e-4
    x = 5e-3 * (1 - np.cos(2.0 * t)) + 5e-4 * (1 - np.cos(25.0 * t))
    stretch = state(lambda s, z: ((np.interp(s, t, x) - z) / tool - spring * z) / damper, t, max_step=2e-3)
    data = channel(CONTACT, t, x, (x - stretch) / tool)
    truth = {"compliance": (tool, 1, -1), "stiffness.k": (spring, -1, 1)}
    return RecoveryCase(data, ("stiffness", "damping"), truth, 0.05)


CASES = [build for name, build in list(globals().items()) if name in EFFECTS]
# Of position and effort: cells under an atomic force microscope, and a press.
SCALES = {"as it is": (1.0, 1.0), "nanonewtons": (1e-3, 1e-8), "kilonewtons": (3.0, 1e4)}
IN_RAD = load_dependent_presliding  # beside it is a weight, which goes with an angle in rad


def scaled(case, name, length, effort):
    """The channel of a case with noise, and the parameters by effect, in other units."""
    data = case.data
    motion = ("time_s",) if case.of_time else ("position", "velocity", "acceleration")
    units = {"load": effort, "joint_velocity": length, "joint_acceleration": length}
    noise = NOISE * np.sqrt(np.mean(data.effort**2)) * np.random.default_rng(0).standard_normal(len(data))
    changed = {
        "effort": effort * (data.effort + noise),
        "context": {key: units.get(key, 1.0) * signal for key, signal in data.context.items()},
        **{key: length * getattr(data, key) for key in motion},
    }
    truth = {}
    for parameter, value in case.truth.items():
        size, by_length, by_effort = value if isinstance(value, tuple) else (value, 0, 0)
        key = parameter if "." in parameter else f"{name}.{parameter}"
        truth[key] = size * length**by_length * effort**by_effort
    return replace(data, **changed), truth


@cache
def made(build):
    """A case, simulated once for all its scales."""
    return build()


@pytest.mark.parametrize(
    ("built", "scale"),
    [
        (IN_RAD, "as it is"),
        *(
            pytest.param(case, scale, marks=() if (number + size) % 2 else pytest.mark.slow)
            for number, case in enumerate(each for each in CASES if each != IN_RAD)
            for size, scale in enumerate(list(SCALES)[1:])
        ),
    ],
)
def test_simulated_effect_is_recovered_without_its_formula(built, scale):
    case, name = made(built), built.__name__
    data, truth = scaled(case, name, *SCALES[scale])
    found, left = recover(data, case.base, name)
    for parameter, value in truth.items():
        assert found[parameter] == pytest.approx(value, rel=case.within), parameter
    assert left < case.left
    assert EFFECTS[name]().applies_to(data)


def test_ripple_harmonics_are_sines_and_cosines_of_the_angle():
    time_s = np.arange(9000) * 1e-3
    data = channel(REVOLUTE, time_s, 3.0 * np.sin(time_s), np.zeros(9000))
    multiples = (1, 2, 7, 12, 144)
    angle = np.multiply.outer(0.5 * data.position, multiples)
    seen = 0.5 * np.array(multiples) * np.ptp(data.position) >= 3.0 * np.pi
    expected = np.hstack([np.sin(angle) * seen, np.cos(angle) * seen])
    assert not seen[:2].any()
    columns = EFFECTS["torque_ripple"](multiples).columns(data, {"cycles": 0.5})
    np.testing.assert_allclose(columns, expected, atol=1e-12)


def test_harmonics_are_found_beside_the_torque_of_other_joints():
    """The rigid-body torque of an arm depends on joints that this one does not know."""
    lone = swings(1, lambda q, v, a: 0.2 * np.sin(16.0 * q) + 0.06 * np.sin(32.0 * q + 2.0))
    others = 5.0 * np.sin(7.3 * lone.time_s) * np.cos(1.7 * lone.time_s)
    torque = {"rigid_body_torque": 2.0 * np.sin(lone.position) + others}
    data = replace(lone, effort=lone.effort + others, context=torque)
    cycles, multiples = harmonics(data)
    assert (cycles, multiples) == (pytest.approx(16.0, rel=0.01), (1, 2))
    assert harmonics(replace(data, context={})) != (cycles, multiples)  # not the cached result


def test_link_share_keeps_its_meaning_only_with_a_weight_in_the_model():
    """The search takes each effect off a model in turn, and keeps the form of the others."""
    data = swings(1)
    heavy = Model("inertia", tuple(EFFECTS[name]() for name in ("inertia", "viscous_friction", "weight")))
    start = fit_model(data, heavy, {})
    friction = EFFECTS["load_dependent_friction"]().suited_to(start.data)
    assert [parameter.name for parameter in friction.inner] == ["transition", "link_share"]
    whole = fit_model(data, heavy.with_effect(friction), start.solution.parameters)
    less = fit_model(data, whole.solution.model.without("weight"), whole.solution.parameters)
    assert np.isfinite(less.rmse)
