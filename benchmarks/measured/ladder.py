"""Find by plain least squares what a model of a converted recording lacks, without palpate's engine.

    python benchmarks/measured/ladder.py FILE.csv[.gz] --base stiffness damping [--steps 5] [--rows 2500]

Each term is one or a few columns, with a grid of its inner parameter. Each run is predicted by a fit to the
other runs (in a single run, every fourth of twelve blocks of time by a fit to the others). Terms are added
one after the other, the best first; each is also shown alone beside the base. Errors are root mean squares in
the effort's unit. A term that should oppose the motion but drives it is marked. Gains have no bounds here,
and an effort that comes late looks like this.
"""

import itertools
import math
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import savgol_filter

Array = NDArray[np.float64]
Build = Callable[["Signals", float], Array]

_ROWS = 4000  # rows that are fitted; every term is computed before rows are left out


@dataclass
class Signals:
    """One recording: all arrays of length n, in SI units."""

    t: Array
    x: Array
    v: Array
    a: Array
    effort: Array
    run: NDArray[np.int64]
    contact: bool
    context: dict[str, Array]

    def runs(self) -> list[slice]:
        """Return the rows of each run."""
        edges = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), len(self.run)]
        return [slice(start, stop) for start, stop in itertools.pairwise(edges)]

    def by_run(self, build: Callable[[slice], Array]) -> Array:
        """Apply a function to the rows of each run, and concatenate the results."""
        return np.concatenate([build(part) for part in self.runs()])

    @property
    def depth(self) -> Array:
        """Depth of a contact, otherwise the position."""
        return np.maximum(self.x, 0.0) if self.contact else self.x

    @property
    def size(self) -> float:
        """Range of the position."""
        return float(np.ptp(self.x)) or 1.0

    @property
    def speed(self) -> float:
        """A large speed."""
        return float(np.percentile(np.abs(self.v), 95)) or 1.0


def _smooth(x: Array, t: Array, order: int, window: int) -> Array:
    step = float(np.median(np.diff(t)))
    window = min(window, (len(x) - 1) // 2 * 2 + 1)
    return np.asarray(savgol_filter(x, window, 3, deriv=order, delta=step), dtype=np.float64)


def load(path: Path) -> Signals:
    """Read a converted recording of one channel; velocity is derived if it was not measured."""
    rows = pd.read_csv(path)
    table = {name: column.to_numpy(np.float64) for name, column in rows.items()}
    x_name = next(name for name in table if name.startswith(("displacement", "position")))
    f_name = next(name for name in table if name.startswith(("force", "torque")))
    measured = next((values for name, values in table.items() if name.startswith("velocity")), None)
    known = ("displacement", "position", "velocity", "force", "torque", "time", "run")
    context = {name: values for name, values in table.items() if not name.startswith(known)}
    x, t, run = table[x_name], table["time_s"], table["run"].astype(np.int64)
    s = Signals(t, x, x, x, table[f_name], run, x_name.startswith("displacement"), context)
    if measured is None:
        s.v, s.a = (s.by_run(lambda part, n=n: _smooth(x[part], t[part], n, 11)) for n in (1, 2))
    else:
        s.v, s.a = measured, s.by_run(lambda part: _smooth(measured[part], t[part], 1, 7))
    return s


def thin(s: Signals, rows: int) -> Signals:
    """Return at most `rows` evenly spaced rows of the first eight runs, because memory terms are slow."""
    kept = np.flatnonzero(np.isin(s.run, np.unique(s.run)[:8]))
    kept = kept[:: math.ceil(len(kept) / rows)]
    context = {name: values[kept] for name, values in s.context.items()}
    signals = (values[kept] for values in (s.t, s.x, s.v, s.a, s.effort, s.run))
    return Signals(*signals, s.contact, context)


def _power(s: Signals, exponent: float) -> Array:
    x = s.depth / s.size
    return np.sign(x) * np.abs(x) ** exponent


def _dahl(s: Signals, path: float) -> Array:
    """Return the state of presliding friction, which changes sign over `path` (share of the range)."""
    scale = path * s.size

    def turned(part: slice) -> Array:
        state, z = 0.0, np.zeros(part.stop - part.start)
        for i, dx in enumerate(np.diff(s.x[part], prepend=s.x[part][0])):
            if dx:
                state += (math.copysign(1.0, dx) - state) * -math.expm1(-abs(dx) / scale)
            z[i] = state
        return z

    return s.by_run(turned)


def _play(s: Signals, half: float) -> Array:
    """Return the position minus its follower with a play of `half` (share of the range): spring and stops."""
    width = half * s.size

    def lost(part: slice) -> Array:
        x = s.x[part]
        y, out = x[0], np.zeros(len(x))
        for i, xi in enumerate(x):
            y = min(max(y, xi - width), xi + width)
            out[i] = xi - y
        return out / s.size

    return s.by_run(lost)


def _relaxed(elastic: Array, s: Signals, tau: float) -> Array:
    """Return the Maxwell branch of an elastic column: dz/dt = d(elastic)/dt - z/tau."""

    def branch(part: slice) -> Array:
        t, e = s.t[part], elastic[part]
        z = np.zeros(len(t))
        for i in range(1, len(t)):
            decay = math.exp(-max(t[i] - t[i - 1], 0.0) / tau)
            z[i] = z[i - 1] * decay + (e[i] - e[i - 1]) * (1.0 + decay) / 2.0
        return z

    return s.by_run(branch)


def _held_max(s: Signals, share: float) -> Array:
    """Return a spring whose zero has moved by `share` of the deepest indentation so far in its run."""
    deepest = s.by_run(lambda part: np.maximum.accumulate(s.depth[part]))
    return np.maximum(s.depth - share * deepest, 0.0) / s.size


def _neck(s: Signals, reach: float) -> Array:
    """Return adhesion: zero before touch, one below the surface, decaying over `reach` above it."""
    touched = s.by_run(lambda part: np.maximum.accumulate(s.x[part] > 0).astype(float))
    return np.asarray(touched * np.exp(np.minimum(s.x, 0.0) / (reach * s.size)), dtype=np.float64)


def _since(s: Signals) -> Array:
    restarts = np.cumsum(np.maximum(-np.diff(s.t, prepend=s.t[0]), 0.0))
    return np.asarray(s.t - s.t[0] + restarts, dtype=np.float64)


def _spline(s: Signals, _inner: float) -> Array:
    knots = np.quantile(s.depth, np.arange(0.05, 1.0, 0.1))
    return np.maximum(s.depth[:, None] - knots, 0.0) / s.size


@dataclass(frozen=True)
class Term:
    """One candidate law."""

    kind: str
    build: Build
    inner: tuple[float, ...] = (0.0,)


_TIMES = tuple(float(tau) for tau in np.geomspace(0.01, 300.0, 12))
_WIDTHS = (0.002, 0.01, 0.03, 0.1, 0.3)

TERMS: dict[str, Term] = {
    "stiffness": Term("elastic_shape", lambda s, p: s.depth),
    "power_law": Term("elastic_shape", _power, (0.3, 0.5, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0)),
    "exponential": Term("elastic_shape", lambda s, p: np.expm1(p * s.depth / s.size), (2.0, 4.0, 8.0, 16.0)),
    "layer": Term("elastic_shape", lambda s, p: np.maximum(s.depth / s.size - p, 0.0), (0.2, 0.4, 0.6, 0.8)),
    "spline": Term("elastic_shape", _spline),
    "damping": Term("rate_dependence", lambda s, p: np.where(s.x > 0, s.v, 0.0) if s.contact else s.v),
    "quadratic_rate": Term("rate_dependence", lambda s, p: s.v * np.abs(s.v)),
    # dry friction: changes sign at once, and grows more slowly than the speed
    "root_rate": Term("friction", lambda s, p: np.sign(s.v) * np.abs(s.v / s.speed) ** p, (0.25, 0.5)),
    "depth_rate": Term("rate_dependence", lambda s, p: s.depth * s.v),
    "coulomb": Term("friction", lambda s, p: np.tanh(s.v / (p * s.speed)), (0.003, 0.02, 0.1, 0.3)),
    "asymmetric": Term(
        "friction", lambda s, p: 1.0 * np.column_stack([s.v > p * s.speed, s.v < -p * s.speed]), (0.01,)
    ),
    "presliding": Term("friction", _dahl, _WIDTHS),
    "play": Term("friction", _play, _WIDTHS),
    "play_family": Term("friction", lambda s, p: np.column_stack([_play(s, w) for w in _WIDTHS])),
    "depth_friction": Term("friction", lambda s, p: np.abs(s.depth) * np.tanh(s.v / (0.02 * s.speed))),
    "relaxation": Term("time_memory", lambda s, p: _relaxed(s.depth, s, p), _TIMES),
    "relaxation_of_square": Term("time_memory", lambda s, p: _relaxed(s.depth**2, s, p), _TIMES),
    "two_relaxations": Term(
        "time_memory",
        lambda s, p: np.column_stack([_relaxed(s.depth, s, p), _relaxed(s.depth, s, 12.0 * p)]),
        _TIMES[2:-2],
    ),
    "inertia": Term("inertia", lambda s, p: s.a),
    "ripple": Term(
        "periodic",
        lambda s, p: np.column_stack([np.sin(p * s.x), np.cos(p * s.x)]),
        (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 18, 20, 24, 28, 36, 42, 48, 72, 84, 100),
    ),
    "weight": Term("gravity_load", lambda s, p: np.column_stack([np.sin(s.x), np.cos(s.x)])),
    "offset": Term("contact_geometry", lambda s, p: (s.x > 0).astype(float)),
    "neck": Term("contact_geometry", _neck, (0.003, 0.03, 0.1, 0.3)),
    "surface": Term(
        "contact_geometry", lambda s, p: np.maximum(s.x + p * s.size, 0.0), (-0.1, -0.03, 0.03, 0.1, 0.3)
    ),
    "set": Term("contact_geometry", _held_max, (0.1, 0.3, 0.5, 0.7, 0.9)),
    "bias": Term("sensor_statics", lambda s, p: np.ones_like(s.x)),
    "drift": Term("drift", lambda s, p: _since(s)),
    "run_offset": Term("run_differences", lambda s, p: (s.run[:, None] == np.unique(s.run)).astype(float)),
}
_LATE = "late base"
_OPPOSING = {"friction", "rate_dependence", "time_memory"}
_CONTACT_ONLY = {"offset", "neck", "surface", "set", "depth_rate"}
_REVOLUTE_ONLY = {"ripple", "weight"}


def folds_of(s: Signals) -> NDArray[np.int64]:
    """Return the fold of each row: up to six groups of runs, or of one run every fourth of twelve blocks."""
    runs = np.unique(s.run)
    if len(runs) == 1:
        return np.asarray(np.arange(len(s.run)) * 12 // len(s.run) % 4, dtype=np.int64)
    return np.asarray(np.searchsorted(runs, s.run) % min(6, len(runs)), dtype=np.int64)


def _held_out(columns: Array, ladder: "Ladder") -> tuple[float, float]:
    """Return the held-out error, and the sum of the mean squares in the fitted folds."""
    fold, effort = ladder.fold[ladder.rows], ladder.signals.effort[ladder.rows]
    scale = np.sqrt((columns**2).mean(axis=0))
    joint = np.column_stack([columns[ladder.rows] / np.where(scale > 0, scale, 1.0), effort])
    grams = [joint[fold == number].T @ joint[fold == number] for number in np.unique(fold)]
    outside, inside = 0.0, 0.0
    for number, gram in zip(np.unique(fold), grams, strict=True):
        rest = np.sum(grams, axis=0) - gram
        weights = np.append(-np.linalg.lstsq(rest[:-1, :-1], rest[:-1, -1], rcond=1e-10)[0], 1.0)
        outside += float(weights @ gram @ weights)
        inside += float(weights @ rest @ weights) / (fold != number).sum()
    return math.sqrt(max(outside, 0.0) / len(fold)), inside


class Ladder:
    """Least squares of terms, one after the other."""

    def __init__(self, s: Signals, base: list[str]) -> None:
        self.signals = s
        self.fold = folds_of(s)
        self.rows = np.unique(np.linspace(0, len(s.x) - 1, min(_ROWS, len(s.x))).astype(np.int64))
        self.columns = np.column_stack([TERMS[name].build(s, 0.0) for name in base])
        self.error = _held_out(self.columns, self)[0]
        revolute = not s.contact and float(np.ptp(s.x)) > 0.5
        left_out = (set() if s.contact else _CONTACT_ONLY) | (set() if revolute else _REVOLUTE_ONLY)
        self.built = {
            name: [(p, term.build(s, p)) for p in term.inner]
            for name, term in TERMS.items()
            if name not in {*base, *left_out, "run_offset"}
        }
        slopes = s.by_run(lambda part: np.gradient(self.columns[part], s.t[part], axis=0))
        self.built[_LATE] = [(0.0, slopes)]  # the base model, delayed by a fixed time
        for name, values in s.context.items():
            self.built[f"context {name}"] = [(0.0, np.stack([values, values * s.x, values * s.v], axis=1))]

    def attempt(self, name: str) -> tuple[float, float, Array]:
        """Return the held-out error with a term, its inner parameter (best in the fit), and its columns."""
        trials = [
            (*_held_out(np.column_stack([self.columns, columns]), self), p, columns)
            for p, columns in self.built[name]
        ]
        held_out, _, p, columns = min(trials, key=lambda trial: trial[1])
        return held_out, p, columns

    def drives(self, kind: str, columns: Array) -> bool:
        """Return whether columns of a kind that opposes the motion do work on it beside the ladder."""
        joint = np.column_stack([columns, self.columns])[self.rows]
        count = joint.shape[1] - self.columns.shape[1]
        gains = np.linalg.lstsq(joint, self.signals.effort[self.rows], rcond=1e-9)[0]
        work = float(self.signals.v[self.rows] @ joint[:, :count] @ gains[:count])
        return kind in _OPPOSING and work < 0.0

    def of_runs(self) -> tuple[float, float]:
        """Return the errors on odd rows with an offset, and with a gain, of each run found from even rows."""
        effort, columns, run = (a[self.rows] for a in (self.signals.effort, self.columns, self.signals.run))
        model = columns @ np.linalg.lstsq(columns, effort, rcond=1e-9)[0]
        residual = effort - model
        offset, gain = [], []
        for number in np.unique(self.signals.run):
            of_run = np.flatnonzero(run == number)
            even, odd = of_run[::2], of_run[1::2]
            offset.append(residual[odd] - residual[even].mean())
            share = model[even] @ residual[even] / max(float(model[even] @ model[even]), 1e-300)
            gain.append(residual[odd] - share * model[odd])
        first, second = (float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in (offset, gain))
        return first, second


def kind_of(name: str) -> str:
    """Return the kind of a term."""
    if name == _LATE:
        return "sensor_dynamics"
    return "recorded_context" if name.startswith("context ") else TERMS[name].kind


def main() -> None:
    """Print the ladder of one file."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--base", nargs="+", required=True, choices=sorted(TERMS))
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rows", type=int, help="of at most eight runs; default: all rows")
    options = parser.parse_args()
    s = load(options.file)
    if options.rows:
        s = thin(s, options.rows)
    ladder = Ladder(s, options.base)
    print(f"rows {len(s.x)}, runs {len(np.unique(s.run))}, effort {s.effort.std():.4g} about its mean")
    print(f"base {' + '.join(options.base)}: {ladder.error:.4g}")
    if "damping" in options.base and ladder.drives("rate_dependence", TERMS["damping"].build(s, 0.0)):
        print("  its damping drives the motion")
    offset, gain = ladder.of_runs()
    print(f"  alone: run offset {offset:.4g}, run gain {gain:.4g}")
    for step in range(options.steps):
        trials = sorted((ladder.attempt(name)[:2], name) for name in ladder.built)
        shown = []
        for (error, p), name in trials[: 4 if step else 14]:
            mark = " drives the motion" * ladder.drives(kind_of(name), ladder.attempt(name)[2])
            shown.append(f"{name}({p:.3g}) [{kind_of(name)}] {error:.4g}{mark}")
        print("  " + "; ".join(shown))
        (error, p), name = trials[0]
        if error > 0.98 * ladder.error:
            break
        print(f"+ {name}({p:.3g}) [{kind_of(name)}]: {error:.4g}")
        ladder.columns = np.column_stack([ladder.columns, ladder.attempt(name)[2]])
        ladder.error = error
        if len(ladder.built[name]) == 1:
            del ladder.built[name]
    offset, gain = ladder.of_runs()
    print(f"  then: run offset {offset:.4g}, run gain {gain:.4g}")


if __name__ == "__main__":
    main()
