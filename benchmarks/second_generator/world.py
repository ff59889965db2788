"""The world of a case before anything is hidden in it, and the ways in which an effect changes it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .motion import FINE_HZ, Array, TrueMotion

Truth = dict[str, float]


@dataclass(frozen=True)
class CaseWorld:
    """A motion and its simple law."""

    kind: str  # "contact" or "revolute"
    motion: TrueMotion  # the true one
    base: str  # "kelvin_voigt", "inertia", "pendulum" or "rigid_body"
    law: dict[str, float]  # its parameters: k, c of a contact; J, g, d of a joint
    size: float  # depth or swing of the deepest run [m or rad]
    fresh: bool  # in a contact: whether each run presses a new spot

    @property
    def pressed(self) -> Array:
        """Depth while pressed, otherwise 0."""
        return np.maximum(self.motion.x, 0.0)

    @property
    def touching(self) -> Array:
        """1 while pressed, otherwise 0."""
        return (self.motion.x > 0.0).astype(float)

    @property
    def speed(self) -> float:
        """The 95 % quantile of the speed [m/s or rad/s]."""
        return float(np.quantile(np.abs(self.motion.v), 0.95))

    @property
    def load(self) -> Array:
        """Effort of the simple law without its damping."""
        m = self.motion
        if self.kind == "contact":
            return self.law["k"] * self.pressed
        return self.law["J"] * m.a + self.law["g"] * np.sin(m.x)

    @property
    def plain(self) -> Array:
        """Effort of the simple law; an object can only push."""
        if self.kind == "contact":
            push = self.law["k"] * self.pressed + self.law["c"] * self.motion.v * self.touching
            return np.maximum(push, 0.0)
        return self.load + self.law["d"] * self.motion.v

    @property
    def scale(self) -> float:
        """The 98 % quantile of the simple law's effort."""
        return float(np.quantile(np.abs(self.plain), 0.98))

    @property
    def columns(self) -> Array:
        """Regressors of the simple law."""
        m = self.motion
        if self.kind == "contact":
            return np.column_stack([self.pressed, m.v * self.touching])
        if self.base == "rigid_body":
            return np.zeros((len(m.t), 1))
        shapes = [m.a, m.v]
        return np.column_stack([*shapes, np.sin(m.x)] if self.base == "pendulum" else shapes)

    def by_run(self, work: Callable[[slice], Array]) -> Array:
        """Compute a signal with memory, which starts anew in each run."""
        return np.concatenate([work(rows) for rows in self.motion.each()])

    def rate(self, signal: Array) -> Array:
        """Differentiate a fine signal within each run."""
        return self.by_run(lambda rows: np.gradient(signal[rows], 1 / FINE_HZ))

    def filtered(self, signal: Array, time_s: float) -> Array:
        """Return a first-order lag of a signal that is linear within a step, accurate to second order."""
        keep = np.exp(-1 / (FINE_HZ * time_s))

        def lag(rows: slice) -> Array:
            half, first = 0.5 * (1 - keep), signal[rows][0]
            return lfilter([half, half], [1, -keep], signal[rows], zi=[(1 - half) * first])[0]

        return self.by_run(lag)

    def later(self, signal: Array, time_s: float) -> Array:
        """Return a delayed signal."""
        return self.by_run(
            lambda rows: np.interp(self.motion.t[rows] - time_s, self.motion.t[rows], signal[rows])
        )

    def deepest(self) -> Array:
        """Return the largest depth so far: in this run on new spots, otherwise in the session."""
        if self.fresh:
            return self.by_run(lambda rows: np.maximum.accumulate(self.pressed[rows]))
        return np.maximum.accumulate(self.pressed)


@dataclass(frozen=True)
class HiddenEffect:
    """Changes that an effect of a certain size causes."""

    adds: Array | float = 0.0  # added to the effort of the object or joint, shape (n,)
    one_sided: bool = False  # whether `adds` belongs to an object that can only push
    # Maps the true effort to the error of the position reading.
    moves: Callable[[Array], Array] | None = None
    # Maps the effort to the sensor reading; None for an exact sensor.
    senses: Callable[[Array], Array] | None = None
    # Its parameters by the names of the library, if it has them. Parameters of another effect, such as the
    # spring that it replaces, are named "effect.parameter".
    truth: Truth | None = None


# Arguments: the world, a size in (0, 1], and four random numbers in [0, 1).
Effect = Callable[[CaseWorld, float, Array], HiddenEffect]


def by_name(*effects: Effect) -> dict[str, Effect]:
    """Return effects by the names of their functions."""
    return {effect.__name__: effect for effect in effects}


def effort_and_position(world: CaseWorld, hidden: Iterable[HiddenEffect]) -> tuple[Array, Array]:
    """Return the sensed effort without noise, and the read position without steps."""
    some = list(hidden)
    m = world.motion
    one_sided = [effect.adds for effect in some if effect.one_sided]
    if world.kind == "contact":
        push = world.law["k"] * world.pressed + world.law["c"] * m.v * world.touching
        effort = np.maximum(push + sum(one_sided), 0.0) * world.touching
    else:
        effort = world.plain + sum(one_sided)
    effort = effort + sum(effect.adds for effect in some if not effect.one_sided)
    position = m.x.copy()
    for effect in some:
        if effect.moves:
            position = position + effect.moves(effort)
    for effect in some:
        if effect.senses:
            effort = effect.senses(effort)
    return effort, position


def not_mimicked(world: CaseWorld, hidden: Iterable[HiddenEffect]) -> float:
    """Return the RMS of the part of some effects that the simple law cannot mimic."""
    effort, position = effort_and_position(world, hidden)
    m = world.motion
    v = world.rate(position)
    read = TrueMotion(m.t, position, v, world.rate(v), m.run)
    seen = CaseWorld(world.kind, read, world.base, world.law, world.size, world.fresh)
    rows = slice(None, None, 4)
    columns = seen.columns[rows]
    norm = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(norm > 0, norm, 1.0)
    rest = effort[rows] - seen.plain[rows]  # contact ends before the damper pulls, which no column describes
    gains = np.linalg.lstsq(columns, rest, rcond=None)[0]
    return float(np.sqrt(np.mean((rest - columns @ gains) ** 2)))


def sized(world: CaseWorld, effect: Effect, chances: Array, target: float) -> HiddenEffect | None:
    """Return the effect at the size at which the simple law misses this much; None if it never does."""
    low, high = 1e-4, 1.0
    if not_mimicked(world, [effect(world, high, chances)]) < target:
        return None
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        missed = not_mimicked(world, [effect(world, middle, chances)])
        if abs(missed / target - 1) < 0.03:
            return effect(world, middle, chances)
        low, high = (middle, high) if missed < target else (low, middle)
    return effect(world, high, chances)


def play(signal: Array, width: float) -> Array:
    """Apply the play (backlash) operator: the output follows when an edge of the gap is reached."""
    out = np.empty_like(signal)
    here = float(signal[0])
    half = 0.5 * width
    for i, drive in enumerate(signal.tolist()):
        here = min(max(here, drive - half), drive + half)
        out[i] = here
    return out
