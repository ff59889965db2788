"""Cases: hidden effects, their sizes, world and readings. (seed, number) determines each case."""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from numpy.random import Generator

from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.channel import ChannelData
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS

from . import motion, readings
from .contact_effects import CONTACT, CONTACT_OUTSIDE
from .joint_effects import GRAVITY, IN_RIGID_BODY, JOINT, JOINT_OUTSIDE, NEEDS_GRAVITY
from .motion import Array
from .sensor_effects import AFTER_NOISE
from .world import CaseWorld, HiddenEffect, effort_and_position, sized

STRENGTHS = (3.0, 10.0, 30.0)
MOST_SAMPLES = 20_000  # limit for one case, so that many can be judged; a high sample rate gives fewer runs
RATES_HZ = (1000.0, 500.0, 250.0, 100.0)
TRIES = 12  # worlds drawn until one can hide the effects; a joint without gravity cannot hide a tilt
_PAIRS = yaml.safe_load(Path(__file__).with_name("names.yaml").read_text("utf-8"))["pairs"]
_URDF = Path(__file__).with_name("one_link.urdf").read_text("utf-8")
_LIBRARY = {"contact": CONTACT | CONTACT_OUTSIDE, "revolute": JOINT | JOINT_OUTSIDE}


@dataclass(frozen=True)
class CaseSpec:
    """What to hide; with a seed, it determines the whole case."""

    number: int  # number in the grid, independent of which part is run
    kind: str  # "contact" or "revolute"
    sort: str  # "nothing", "one", "two", "outside", or "removed" (from the library)
    hidden: tuple[str, ...]  # names
    strength: float  # RMS of what the simple law cannot mimic, in floors, of each effect alone


@dataclass(frozen=True)
class GeneratedCase:
    """A channel as a user would have it, with the truth."""

    job: CaseSpec  # what was requested
    channel: ChannelData  # as imported from a CSV file
    model: Model  # simple model
    strength: float  # actual strength; smaller than requested if no world allows it
    floor: float  # RMS error that noise of effort and position causes
    truth: dict[str, float]  # parameters by "effect.parameter", of the simple law as well
    world: str  # short description


def grid() -> list[CaseSpec]:
    """List all jobs in a fixed random order, so that the first jobs are a fair sample."""
    jobs = [
        (kind, sort, hidden, strength)
        for kind, ones, outside in (("contact", CONTACT, CONTACT_OUTSIDE), ("revolute", JOINT, JOINT_OUTSIDE))
        for sort, hidden, strength in (
            *(("nothing", (), 0.0) for _ in range(22)),
            *(("one", (name,), strength) for name in ones for strength in STRENGTHS),
            *(("two", tuple(pair), strength) for pair in _PAIRS[kind] for strength in STRENGTHS[1:]),
            *(("outside", (name,), strength) for name in outside for strength in STRENGTHS[1:]),
        )
    ]
    order = np.random.default_rng(2026).permutation(len(jobs))
    return [CaseSpec(number, *jobs[i]) for number, i in enumerate(order)]


def make(job: CaseSpec, seed: int) -> GeneratedCase | None:
    """Make the case of a job; None if no world can hide its effects even at the smallest strength."""
    for strength in [s for s in STRENGTHS[::-1] if s <= job.strength] or [0.0]:
        rng = np.random.default_rng([seed, job.number, int(strength)])
        for _ in range(TRIES):
            case = _try(job, strength, rng)
            if case is not None:
                return case
    return None


def _try(job: CaseSpec, strength: float, rng: Generator) -> GeneratedCase | None:
    reading = readings.draw_reading(rng, job.kind)
    runs = int(rng.integers(3, 7 if reading.rate_hz < 500.0 else 4))
    world, shape = _contact(rng, reading, runs) if job.kind == "contact" else _joint(rng, runs, job.hidden)
    seconds = len(world.motion.t) / motion.FINE_HZ
    allowed = [rate for rate in RATES_HZ if rate * seconds <= MOST_SAMPLES]
    reading = replace(reading, rate_hz=min(reading.rate_hz, max(allowed, default=RATES_HZ[-1])))
    read = _Reader(rng, reading, world, readings.sample_times(rng, reading, world.motion))
    if read.floor > 0.05 * world.scale:
        return None
    effects = [
        sized(world, _LIBRARY[job.kind][name], rng.uniform(size=4), strength * read.floor)
        for name in job.hidden
    ]
    hidden = [effect for effect in effects if effect is not None]
    if len(hidden) < len(effects):
        return None
    last = [e for e, name in zip(hidden, job.hidden, strict=True) if name in AFTER_NOISE]
    effort, position = effort_and_position(world, [e for e in hidden if e not in last])
    channel = read.channel(effort, position, last)
    base = MODELS[world.base]()
    context = ModelContext(joint=None if world.kind == "contact" else 0)
    if world.base == "rigid_body":
        context = replace(context, arm=Arm(_URDF.format(**world.law), tip_frame="tip"))
    channel, model = base.prepare(channel, context), base.build(context)
    per_turn = "/".join(f"{n}" for n in reading.steps) + " a turn"
    chain = f"printed to {reading.digits_m:g} m" if reading.digits_m else per_turn
    words = (
        f"{world.base}, {shape}, {len(channel.runs)} runs, {reading.rate_hz:.0f} Hz"
        f"{' irregular' if reading.irregular else ''}, {chain}, velocity {reading.velocity}, "
        f"{reading.color} noise"
    )
    return GeneratedCase(job, channel, model, strength, read.floor, _truth(world, job, hidden), words)


def _contact(rng: Generator, reading: readings.ReadingChain, runs: int) -> tuple[CaseWorld, str]:
    """Draw depth and stiffness such that the position steps are neither negligible nor dominant."""
    probe = np.linspace(0.0, 0.02, 4001) + 1e-5 * rng.standard_normal(4001)
    steps = float(np.std(readings.read_position(rng, reading, probe, arm=not reading.digits_m) - probe))
    size = float(np.clip(steps * 10 ** rng.uniform(2.4, 3.6), 5e-4, 0.03))
    k = rng.uniform(3.0, 30.0) / size
    speed = rng.uniform(0.5, 3.0)
    moved, shape = motion.draw(rng, size, speed, runs, below=-0.15, rounding_s=(0.01, 0.02))
    c = k * size * rng.uniform(0.02, 0.2) / float(np.quantile(np.abs(moved.v), 0.95))
    fresh = bool(rng.random() < 0.5)
    return CaseWorld("contact", moved, "kelvin_voigt", {"k": k, "c": c}, size, fresh), shape


def _joint(rng: Generator, runs: int, hidden: tuple[str, ...]) -> tuple[CaseWorld, str]:
    """Draw an inertia, a pendulum, or an arm of one link with its URDF."""
    base = str(rng.choice(["inertia", "pendulum", "rigid_body"], p=[0.35, 0.4, 0.25]))
    if NEEDS_GRAVITY & set(hidden) and base == "inertia":
        base = "pendulum"
    if set(hidden) & IN_RIGID_BODY.keys() and hidden != ("gravity_tilt",):
        base = "rigid_body"
    mass, arm = rng.uniform(0.3, 4.0), rng.uniform(0.1, 0.4)
    size = rng.uniform(0.4, 1.6)
    speed = rng.uniform(0.6, 2.5)
    moved, shape = motion.draw(rng, size, speed, runs, below=-0.5, rounding_s=(0.03, 0.07))
    law = {"m": mass, "l": arm, "I": 0.3 * mass * arm**2, "J": 1.3 * mass * arm**2, "tip": 1.6 * arm}
    law |= {"g": mass * GRAVITY * arm if base != "inertia" else 0.0, "d": 0.0}
    if base != "rigid_body":
        plain = law["J"] * moved.a + law["g"] * np.sin(moved.x)
        law["d"] = rng.uniform(0.03, 0.3) * float(np.std(plain) / np.std(moved.v))
    return CaseWorld("revolute", moved, base, law, size, False), shape


class _Reader:
    """Converts efforts and positions on the fine grid into a file of readings."""

    def __init__(
        self, rng: Generator, reading: readings.ReadingChain, world: CaseWorld, times: Array
    ) -> None:
        self.reading, self.world, self.times = reading, world, times
        before = np.searchsorted(world.motion.t, times - 0.25 / motion.FINE_HZ)
        self.run = world.motion.run[before.clip(0, len(world.motion.t) - 1)]
        self.seed = int(rng.integers(2**31))
        self.arm = world.kind == "contact" and not reading.digits_m
        plain, x = self.sampled(world.plain), self.sampled(world.motion.x)
        rough = self.through_position(self.positions(x))
        sigma = rough / 10 ** rng.uniform(-0.5, 1.5) if rough > 0 else np.inf
        self.sigma = float(np.clip(sigma, 5e-4 * world.scale, 0.01 * world.scale))
        rest = self.noise(plain) + self.through_position(self.positions(x), whole=True)
        self.floor = float(np.sqrt(np.mean(rest**2)))

    def sampled(self, signal: Array) -> Array:
        return np.interp(self.times, self.world.motion.t, signal)  # time continues between runs

    def positions(self, x: Array) -> Array:
        rng = np.random.default_rng([self.seed, 1])
        return readings.read_position(rng, self.reading, x, arm=self.arm)

    def noise(self, effort: Array) -> Array:
        rng = np.random.default_rng([self.seed, 2])
        return self.sigma * readings.noise(rng, self.reading, effort)

    def through_position(self, read: Array, *, whole: bool = False) -> Array:
        """Return the effort that position errors cause through the simple law: its RMS, or all samples."""
        w, m = self.world, self.world.motion
        x, v, a = (self.sampled(signal) for signal in (m.x, m.v, m.a))
        if w.kind == "contact":
            # near the surface one step decides about contact, and a damper pushes at once
            push = w.law["c"] * v * ((read > 0.0).astype(float) - (x > 0.0))
            missed = w.law["k"] * (np.maximum(read, 0.0) - np.maximum(x, 0.0)) + push
            if self.reading.velocity != "given":
                derived = readings.best_derivative(read, v, self.reading.rate_hz, self.run, 1)
                missed = missed + w.law["c"] * (derived - v) * (x > 0.0)
        else:
            derived = [
                readings.best_derivative(read, true, self.reading.rate_hz, self.run, order)
                for order, true in ((1, v), (2, a))
            ]
            missed = w.law["J"] * (derived[1] - a) + w.law["d"] * (derived[0] - v)
            missed = missed + w.law["g"] * (np.sin(read) - np.sin(x))
        return missed if whole else float(np.sqrt(np.mean(missed**2)))

    def channel(self, effort: Array, position: Array, last: list[HiddenEffect]) -> ChannelData:
        """Return the channel imported from the file; effects after the noise act on the noisy signals."""
        contact, one_of_two = self.world.kind == "contact", self.world.base == "rigid_body"
        joint = "_1" if one_of_two else ""
        true = self.sampled(effort)
        sensed = true + self.noise(true)
        for effect in last:
            sensed = effect.senses(sensed) if effect.senses else sensed
        read = self.positions(self.sampled(position))
        x_name = "displacement_m" if contact else f"position{joint}_rad"
        columns = {
            "time_s": (self.times, "%.6f"),
            x_name: (read, "%.9g"),
            "force_N" if contact else f"torque{joint}_Nm": (sensed, "%.7g"),
        }
        columns["run"] = (self.run, "%d")
        if self.reading.velocity != "none":
            v_name = "velocity_m_s" if contact else f"velocity{joint}_rad_s"
            columns[v_name] = (self.velocity(read, position), "%.7g")
        if one_of_two:
            still = np.zeros(len(read))
            columns |= {"position_2_rad": (still, "%g"), "torque_2_Nm": (still, "%g")}
        with TemporaryDirectory() as folder:
            path, formats = Path(folder) / "case.csv", [form for _, form in columns.values()]
            rows = np.column_stack([values for values, _ in columns.values()])
            np.savetxt(path, rows, formats, ",", header=",".join(columns), comments="")
            return import_file(path, ImportOptions(fresh=self.world.fresh and contact)).channels[0]

    def velocity(self, read: Array, position: Array) -> Array:
        """Return a tachometer velocity, or a slope over the number of samples that a user would choose."""
        true = self.sampled(self.world.rate(position))
        if self.reading.velocity == "given":
            rng = np.random.default_rng([self.seed, 3])
            return true + 0.003 * self.world.speed * rng.standard_normal(len(true))
        tries = [readings.slope(self.times, read, self.run, half) for half in (1, 2, 4, 8, 16, 32)]
        return min(tries, key=lambda slope: float(np.mean((slope - true) ** 2)))


_LAWS = {  # parameters of the simple laws by the library's names
    "kelvin_voigt": {"stiffness.k": "k", "damping.c": "c"},
    "inertia": {"inertia.m": "J", "viscous_friction.d": "d"},
    "pendulum": {"pendulum.inertia": "J", "pendulum.gravity": "g", "viscous_friction.d": "d"},
    "rigid_body": {},
}


def _truth(world: CaseWorld, job: CaseSpec, hidden: list[HiddenEffect]) -> dict[str, float]:
    """Return the true parameters by the library's names."""
    truth = {name: world.law[key] for name, key in _LAWS[world.base].items()}
    for name, effect in zip(job.hidden, hidden, strict=True):
        plain = name.split(" (")[0]
        own = (effect.truth or {}).items()
        truth |= {key if "." in key else f"{plain}.{key}": value for key, value in own}
    if len(hidden) > 1:  # in the library all springs relax; here one relaxes beside another
        truth = {key: value for key, value in truth.items() if not key.startswith("relaxation_spectrum.")}
    return {key: float(value) for key, value in truth.items()}
