"""Effects find a truth that was simulated by other means: equations of motion, quadrature, loops."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.special import beta, betainc

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from tests.estimation.recover import channel, recover
from tests.estimation.swings import swings

CONTACT, REVOLUTE = ChannelKind.CONTACT, ChannelKind.REVOLUTE
NOISE = 1e-3  # of the effort's size


@dataclass(frozen=True)
class RecoveryCase:
    """Data with a known truth."""

    data: object  # the channel, without noise
    base: tuple[str, ...]  # effects of the model beside the one that is looked for
    truth: dict[str, float] = field(default_factory=dict)  # parameters by "effect.parameter"
    within: float = 0.02  # share of the truth by which each may be off
    left: float = 5 * NOISE  # share of the effort's size that may be left


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


def runs(parts):
    """Concatenated signals of several runs and the run of each sample; all clocks begin at zero."""
    number = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    return [np.concatenate(signal) for signal in zip(*parts, strict=True)], number


def hertz(length=1.0, effort=1.0):
    modulus, radius = 5e3, 0.01  # a sphere on soft rubber
    parts = [(t, x, 4 / 3 * modulus * np.sqrt(radius) * x**1.5) for t, x, _ in press(0.006)]
    (t, x, force), run = runs(parts)
    k = 4 / 3 * modulus * np.sqrt(radius) * effort / length**1.5
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    return RecoveryCase(data, (), {"power_law_stiffness.n": 1.5, "power_law_stiffness.k": k}, 0.03)


def fung(length=1.0, effort=1.0):
    at_rest, steep = 40.0, 350.0  # dF/dx = E0 + b F
    depth = np.linspace(0.0, 0.008, 300)
    law = solve_ivp(lambda x, f: at_rest + steep * f, (0, 0.008), [0.0], t_eval=depth, rtol=1e-10, atol=1e-12)
    (t, x, force), run = runs([(t, x, np.interp(x, depth, law.y[0])) for t, x, _ in press(0.008)])
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    truth = {"b": steep / length, "a": at_rest / steep * effort}
    truth = {f"exponential_stiffness.{name}": value for name, value in truth.items()}
    return RecoveryCase(data, ("stiffness",), truth | {"stiffness.k": at_rest * effort / length}, 0.05)


def quasi_linear(length=1.0, effort=1.0):
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
    (t, x, force), run = runs(parts)
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    truth = {"fast": fast, "slow": slow, "fast_time": sooner, "slow_time": later}
    truth = {f"relaxation_spectrum.{name}": value for name, value in truth.items()}
    return RecoveryCase(data, ("power_law_stiffness",), truth | {"power_law_stiffness.n": 2.2}, 0.05)


def scale_free(length=1.0, effort=1.0):
    share, alpha, k = 0.6, 0.25, 2e5  # E = k x^2
    parts = []
    for t, x, ramp_s in press(0.01, ramps_s=(0.1, 1.0, 10.0)):
        rate = 0.01 / ramp_s
        done = np.minimum(ramp_s / np.maximum(t, 1e-12), 1.0)  # share of the time since the start in the ramp
        grown = 2 * k * rate**2 * t ** (2 - alpha) * beta(2, 1 - alpha) * betainc(2, 1 - alpha, done)
        parts.append((t, x, (1 - share) * k * x**2 + share * grown))
    (t, x, force), run = runs(parts)
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    truth = {"power_law_relaxation.share": share, "power_law_relaxation.alpha": alpha}
    return RecoveryCase(data, ("power_law_stiffness",), truth | {"power_law_stiffness.n": 2.0}, 0.05)


def maxwell_branch(length=1.0, effort=1.0):
    spring, branch, tau = 500.0, 300.0, 1.2
    parts = []
    for t, x, ramp_s in press(0.01):
        rate = 0.01 / ramp_s
        law = solve_ivp(
            lambda s, f, rate=rate, ramp_s=ramp_s: branch * rate * (s < ramp_s) - f / tau,
            (0, t[-1]),
            [0.0],
            t_eval=t,
            rtol=1e-8,
            atol=1e-10,
            max_step=ramp_s / 20,
        )
        parts.append((t, x, spring * x + law.y[0]))
    (t, x, force), run = runs(parts)
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    truth = {"stress_relaxation.k1": branch * effort / length, "stress_relaxation.tau": tau}
    return RecoveryCase(data, ("stiffness",), truth, 0.03)


@cache
def dahl(path):
    """Dahl's state by its equation in time, for a swing."""
    t, _, v = swing()
    law = solve_ivp(
        lambda s, z: (np.interp(s, t, v) - abs(np.interp(s, t, v)) * z) / path,
        (0, t[-1]),
        [0.0],
        t_eval=t,
        max_step=t[1] - t[0],
        rtol=1e-6,
    )
    return law.y[0]


def presliding(length=1.0, effort=1.0):
    t, q, v = swing()
    torque = 0.4 * v + 1.3 * dahl(0.05)
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length)
    truth = {"presliding_friction.force": 1.3 * effort, "presliding_friction.presliding": 0.05 * length}
    return RecoveryCase(data, ("viscous_friction",), truth)


def loaded_presliding(length=1.0, effort=1.0):
    t, q, v = swing()
    load = 3.0 * np.sin(q + 0.4) + 0.5
    torque = load + 0.3 * np.abs(load) * dahl(0.03)
    context = {"load": load * effort}
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length, context=context)
    truth = {"load_dependent_presliding.mu": 0.3, "load_dependent_presliding.presliding": 0.03 * length}
    return RecoveryCase(data, ("weight", "bias"), truth)


@cache
def wen(rise, across, along, n):
    """Wen's state by his own equation, for a swing."""
    t, _, v = swing()
    law = solve_ivp(
        lambda s, z: (
            rise * np.interp(s, t, v)
            - across * abs(np.interp(s, t, v)) * abs(z) ** (n - 1) * z
            - along * np.interp(s, t, v) * abs(z) ** n
        ),
        (0, t[-1]),
        [0.0],
        t_eval=t,
        max_step=t[1] - t[0],
        rtol=1e-6,
    )
    return law.y[0]


def yielding(length=1.0, effort=1.0):
    t, q, v = swing()
    rise, across, along, n, alpha = 2.0, 30.0, 10.0, 2.0, 1.5
    torque = 0.4 * v + alpha * wen(rise, across, along, n)
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length)
    most = (rise / (across + along)) ** (1 / n)
    truth = {
        "force": alpha * most * effort,
        "path": most / rise * length,
        "sharpness": n,
        "unloading": 2 * across / (across + along) - 1,
    }
    truth = {f"bouc_wen_hysteresis.{name}": value for name, value in truth.items()}
    return RecoveryCase(data, ("viscous_friction",), truth, 0.05)


def leaning(length=1.0, effort=1.0):
    t, q, v = swing()
    load, place, stands = 2.0 * np.sin(1.3 * t) + 0.4 * np.sin(7 * t), 0.0, []
    for now in load:  # a light link that friction holds, and thick oil in the gap slows
        pull = np.sign(now) * max(abs(now) - 0.5, 0.0)
        place = min(max(place + pull / 0.5 * 2e-3, -0.1), 0.1)
        stands.append(place)
    torque = 5.0 * (q - np.array(stands)) + 0.2 * v
    context = {"load": load * effort}
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length, context=context)
    truth = {"loaded_backlash.gap": 0.2 * length, "stiffness.k": 5.0 * effort / length}
    return RecoveryCase(data, ("stiffness", "viscous_friction"), truth, 0.05, left=0.05)


def early(length=1.0, effort=1.0):
    t = np.arange(3000) * 1e-3 * length  # of time, here
    omega = 2 * np.pi * 60.0 / length  # sixteen samples a period
    envelope = 1.0 + 0.3 * np.sin(0.01 * omega * t)
    q, ahead = envelope * np.sin(omega * t), t + 0.0004 * length
    late = (1.0 + 0.3 * np.sin(0.01 * omega * ahead)) * np.sin(omega * ahead)
    data = channel(REVOLUTE, t, q, 4.0 * late * effort, velocity=np.zeros(3000))
    truth = {"delay.time": -0.0004 * length, "stiffness.k": 4.0 * effort}
    return RecoveryCase(data, ("stiffness",), truth, 0.03)


def eccentric(length=1.0, effort=1.0):
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0, 20, 4000))
    q, v = 9 * np.sin(0.7 * t) * length, 6.3 * np.cos(0.7 * t) * length
    squeeze = 1.0 + 0.4 * np.cos(q / length - 0.6)  # of a seal on an eccentric shaft
    torque = (0.2 * v / length + np.sign(v) * squeeze) * effort
    truth = {"cycles": 1 / length, "level": effort, "cosine": 0.4 * np.cos(0.6) * effort}
    truth = {f"position_dependent_friction.{name}": value for name, value in truth.items()}
    data = channel(REVOLUTE, t, q, torque, velocity=v)
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03)


def slotted(length=1.0, effort=1.0):
    t = np.arange(6000) * 1e-3
    q, v = 8 * np.sin(0.9 * t), 7.2 * np.cos(0.9 * t)
    r, angle = 0.6, 12 * q  # a geometric series of harmonics has a closed form
    torque = 0.3 * v + 2.0 * (r * np.cos(angle) - r**2) / (1 - 2 * r * np.cos(angle) + r**2)
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length)
    truth = {"torque_ripple.cycles": 12.0 / length} | {
        f"torque_ripple.cosine{end}": 2.0 * r**m * effort for m, end in ((1, ""), (2, "_2"), (3, "_3"))
    }
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03, left=0.05)  # of small waves


def rippling_anew(length=1.0, effort=1.0):
    rng = np.random.default_rng(2)
    parts = []
    for _ in range(4):
        t = np.arange(800) * 2e-3
        q, v = 1.5 * np.sin(3 * t), 4.5 * np.cos(3 * t)
        parts.append((t, q, v, 0.4 * v + 0.7 * np.sin(18 * q + rng.uniform(0, 2 * np.pi))))
    (t, q, v, torque), run = runs(parts)
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length, run=run)
    return RecoveryCase(
        data, ("viscous_friction",), {"run_ripple.cycles": 18.0 / length, "run_ripple.share": 1.0}
    )


def retared(length=1.0, effort=1.0):
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(8):
        t, q, v = (signal[:500] for signal in swing())
        parts.append((t, q, v, 4.0 * q + 0.4 * v + rng.normal(0, 0.8)))
    (t, q, v, torque), run = runs(parts)
    data = channel(REVOLUTE, t, q * length, torque * effort, velocity=v * length, run=run)
    truth = {"run_offset.share": 1.0, "stiffness.k": 4.0 * effort / length}
    return RecoveryCase(data, ("stiffness", "viscous_friction"), truth)


def other_specimens(length=1.0, effort=1.0):
    rng = np.random.default_rng(4)
    gains = 1.0 + 0.2 * rng.standard_normal(10)
    parts = [(t, x, gain * 700.0 * x) for gain in gains for t, x, _ in press(0.01, ramps_s=(1.0,))]
    (t, x, force), run = runs(parts)
    data = channel(CONTACT, t, x * length, force * effort, run=run)
    return RecoveryCase(data, ("stiffness",), {"run_gain.share": 1.0}, 0.05)


def warming(length=1.0, effort=1.0):
    t, q, v = swing()
    celsius = 25.0 + 8.0 * np.sin(0.4 * t)
    torque = 5.0 * (1 - 0.02 * (celsius - 25.0)) * q
    change = -0.02 * np.std(celsius) / (1 - 0.02 * (np.mean(celsius) - 25.0))
    context, recorded = {"temperature": celsius}, frozenset({"temperature"})
    data = channel(
        REVOLUTE, t, q * length, torque * effort, velocity=v * length, context=context, recorded=recorded
    )
    return RecoveryCase(data, ("stiffness",), {"recorded_dependence.change_temperature": change})


def wrist(length=1.0, effort=1.0):
    t, q, _ = swing()
    ratio, rotor, drag, dry = 32.0, 4e-5, 8e-4, 0.06  # of the motor behind two joints
    other = 0.9 * np.sin(1.1 * t) + 0.4 * np.cos(3.7 * t)
    speeds = np.column_stack([np.gradient(one, t) for one in (0.2 * other, q, other)])
    rates = np.gradient(speeds, t, axis=0)
    turning = ratio * (speeds[:, 1] + speeds[:, 2])
    motor = rotor * np.gradient(turning, t) + drag * turning + dry * np.tanh(turning / (ratio * 0.01))
    torque = (2.0 * speeds[:, 1] + ratio * motor) * effort  # by virtual work
    context = {"joint_velocity": speeds * length, "joint_acceleration": rates * length}
    data = channel(
        REVOLUTE,
        t,
        q * length,
        torque,
        velocity=speeds[:, 1] * length,
        acceleration=rates[:, 1] * length,
        context=context,
    )
    truth = {
        "joint_coupling.ratio": 1.0,
        "joint_coupling.inertia": rotor * ratio**2 * effort / length,
        "joint_coupling.viscous": drag * ratio**2 * effort / length,
        "joint_coupling.coulomb": dry * ratio * effort,
    }
    return RecoveryCase(data, ("viscous_friction",), truth, 0.03)


def winding_up(length=1.0, effort=1.0):
    t = np.arange(5000) * 2e-3
    waves = ((0.5, 3.0), (0.2, 7.0), (0.05, 23.0))
    link, _, a = (
        sum(size * w**order * np.sin(w * t + order * np.pi / 2) for size, w in waves) for order in range(3)
    )
    load = 5.0 * link + 0.2 * a
    motor = link + 2e-3 * load
    told = load + 1e-3 * np.random.default_rng(1).standard_normal(len(t))  # as a model has it from readings
    data = channel(REVOLUTE, t, motor * length, load * effort, context={"load": told * effort})
    truth = {"joint_elasticity.compliance": 2e-3 * length / effort, "stiffness.k": 5.0 * effort / length}
    return RecoveryCase(data, ("stiffness", "inertia"), truth, 0.05)


def a_tool_that_bends(length=1.0, effort=1.0):
    t = np.arange(4000) * 1e-3
    spring, damper, tool = 500.0, 20.0, 4e-4
    x = 5e-3 * (1 - np.cos(2.0 * t)) + 5e-4 * (1 - np.cos(25.0 * t))
    law = solve_ivp(
        lambda s, z: ((np.interp(s, t, x) - z) / tool - spring * z) / damper,
        (0, t[-1]),
        [0.0],
        t_eval=t,
        max_step=2e-3,
        rtol=1e-8,
    )
    force = (x - law.y[0]) / tool
    data = channel(CONTACT, t, x * length, force * effort)
    truth = {"tool_compliance.compliance": tool * length / effort, "stiffness.k": spring * effort / length}
    return RecoveryCase(data, ("stiffness", "damping"), truth, 0.05)


CASES = {
    "joint_elasticity": winding_up,
    "tool_compliance": a_tool_that_bends,
    "power_law_stiffness": hertz,
    "exponential_stiffness": fung,
    "relaxation_spectrum": quasi_linear,
    "power_law_relaxation": scale_free,
    "stress_relaxation": maxwell_branch,
    "presliding_friction": presliding,
    "load_dependent_presliding": loaded_presliding,
    "bouc_wen_hysteresis": yielding,
    "loaded_backlash": leaning,
    "delay": early,
    "position_dependent_friction": eccentric,
    "torque_ripple": slotted,
    "run_ripple": rippling_anew,
    "run_offset": retared,
    "run_gain": other_specimens,
    "recorded_dependence": warming,
    "joint_coupling": wrist,
}
# Of position and effort: cells under an atomic force microscope, and a press.
SCALES = {"as it is": (1.0, 1.0), "nanonewtons": (1e-3, 1e-8), "kilonewtons": (3.0, 1e4)}
IN_RAD = "load_dependent_presliding"  # beside it is a weight, which goes with an angle in rad


def noisy(data, rng):
    """The channel with white noise on its effort."""
    size = NOISE * np.sqrt(np.mean(data.effort**2))
    return type(data)(**{**vars(data), "effort": data.effort + size * rng.standard_normal(len(data))})


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        (IN_RAD, "as it is"),
        *((name, s) for name in CASES for s in ("nanonewtons", "kilonewtons") if name != IN_RAD),
    ],
)
def test_finds_what_was_simulated_without_its_formula(name, scale):
    case = CASES[name](*SCALES[scale])
    found, left = recover(noisy(case.data, np.random.default_rng(0)), case.base, name)
    for parameter, value in case.truth.items():
        assert found[parameter] == pytest.approx(value, rel=case.within), parameter
    assert left < case.left
    assert EFFECTS[name]().applies_to(case.data)


def test_multiples_of_a_ripple_are_sines_and_cosines_of_multiples_of_the_angle():
    time_s = np.arange(9000) * 1e-3
    data = channel(REVOLUTE, time_s, 3.0 * np.sin(time_s), np.zeros(9000))
    multiples = (1, 2, 7, 12, 144)
    angle = np.multiply.outer(0.5 * data.position, multiples)
    seen = 0.5 * np.array(multiples) * np.ptp(data.position) >= 3.0 * np.pi
    expected = np.hstack([np.sin(angle) * seen, np.cos(angle) * seen])
    assert not seen[:2].any()
    columns = EFFECTS["torque_ripple"](multiples).columns(data, {"cycles": 0.5})
    np.testing.assert_allclose(columns, expected, atol=1e-12)


def test_a_share_of_the_link_stays_without_meaning_where_a_weight_is_taken_off_the_model():
    """The search takes each effect off a model in turn, and keeps the form of the others."""
    data = swings(1)
    heavy = Model("inertia", tuple(EFFECTS[name]() for name in ("inertia", "viscous_friction", "weight")))
    start = fit_model(data, heavy, {})
    friction = EFFECTS["load_dependent_friction"]().suited_to(start.data)
    assert [parameter.name for parameter in friction.inner] == ["transition", "link_share"]
    whole = fit_model(data, heavy.with_effect(friction), start.solution.parameters)
    less = fit_model(data, whole.solution.model.without("weight"), whole.solution.parameters)
    assert np.isfinite(less.rmse)
