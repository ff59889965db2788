"""Say by plain least squares what a converted recording is missing, with no part of palpate's engine.

    python benchmarks/measured/ladder.py FILE.csv[.gz] --base stiffness damping [--steps 5] [--rows 2500]

Every term is a column or a few of them, with a grid of its inner parameter. A run is predicted by what was
fitted to the other runs (of one run: every fourth of twelve blocks of time by the others). Terms are added
one after the other, the best first; each is also shown alone beside the base. Errors are root mean squares
in the effort's unit.
"""

import csv
import gzip
import itertools
import math
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
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
        """Rows of each run."""
        edges = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), len(self.run)]
        return [slice(start, stop) for start, stop in itertools.pairwise(edges)]


def _smooth(x: Array, t: Array, order: int, window: int) -> Array:
    step = float(np.median(np.diff(t)))
    window = min(window, (len(x) - 1) // 2 * 2 + 1)
    return np.asarray(savgol_filter(x, window, 3, deriv=order, delta=step), dtype=np.float64)


def load(path: Path) -> Signals:
    """Read a converted recording of one channel; velocity is derived where it was not measured."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        reader = csv.reader(file)
        names = next(reader)
        rows = np.array([[float(cell) for cell in row] for row in reader])
    table = dict(zip(names, rows.T, strict=True))
    x_name = next(name for name in table if name.startswith(("displacement", "position")))
    f_name = next(name for name in table if name.startswith(("force", "torque")))
    measured = next((values for name, values in table.items() if name.startswith("velocity")), None)
    known = ("displacement", "position", "velocity", "force", "torque", "time", "run")
    context = {name: values for name, values in table.items() if not name.startswith(known)}
    x, run = table[x_name], table["run"].astype(np.int64)
    v, a = np.zeros_like(x), np.zeros_like(x)
    s = Signals(table["time_s"], x, v, a, table[f_name], run, x_name.startswith("displacement"), context)
    for part in s.runs():
        v[part] = _smooth(x[part], s.t[part], 1, 11) if measured is None else measured[part]
        a[part] = (
            _smooth(x[part], s.t[part], 2, 11) if measured is None else _smooth(v[part], s.t[part], 1, 7)
        )
    return s


def thin(s: Signals, rows: int) -> Signals:
    """At most `rows` rows, evenly, of the first eight runs: terms with a memory are slow."""
    kept = np.flatnonzero(np.isin(s.run, np.unique(s.run)[:8]))
    kept = kept[:: math.ceil(len(kept) / rows)]
    context = {name: values[kept] for name, values in s.context.items()}
    return Signals(
        s.t[kept], s.x[kept], s.v[kept], s.a[kept], s.effort[kept], s.run[kept], s.contact, context
    )


def _by_run(build: Callable[[Signals, slice], Array], s: Signals) -> Array:
    return np.concatenate([build(s, part) for part in s.runs()])


def _depth(s: Signals) -> Array:
    return np.maximum(s.x, 0.0) if s.contact else s.x


def _size(s: Signals) -> float:
    return float(np.ptp(s.x)) or 1.0


def _speed(s: Signals) -> float:
    return float(np.percentile(np.abs(s.v), 95)) or 1.0


def _power(s: Signals, exponent: float) -> Array:
    x = _depth(s) / _size(s)
    return np.sign(x) * np.abs(x) ** exponent


def _dahl(s: Signals, path: float) -> Array:
    """State of presliding friction: it turns over `path` (share of the range) after each reversal."""
    scale = path * _size(s)

    def one(s: Signals, part: slice) -> Array:
        state, z = 0.0, np.zeros(part.stop - part.start)
        for i, dx in enumerate(np.diff(s.x[part], prepend=s.x[part][0])):
            goal = math.copysign(1.0, dx) if dx else 0.0
            state += (goal - state) * -math.expm1(-abs(dx) / scale) if dx else 0.0
            z[i] = state
        return z

    return _by_run(one, s)


def _play(s: Signals, half: float) -> Array:
    """Position less what follows it with a play of `half` (share of the range): spring and stops."""
    width = half * _size(s)

    def one(s: Signals, part: slice) -> Array:
        x = s.x[part]
        y, out = x[0], np.zeros(len(x))
        for i, xi in enumerate(x):
            y = min(max(y, xi - width), xi + width)
            out[i] = xi - y
        return out / _size(s)

    return _by_run(one, s)


def _relaxed(elastic: Array, s: Signals, tau: float) -> Array:
    """Maxwell branch of an elastic column: dz/dt = d(elastic)/dt - z/tau."""

    def one(s: Signals, part: slice) -> Array:
        t, e = s.t[part], elastic[part]
        z = np.zeros(len(t))
        for i in range(1, len(t)):
            decay = math.exp(-max(t[i] - t[i - 1], 0.0) / tau)
            z[i] = z[i - 1] * decay + (e[i] - e[i - 1]) * (1.0 + decay) / 2.0
        return z

    return _by_run(one, s)


def _held_max(s: Signals, share: float) -> Array:
    """Spring whose zero has moved by `share` of the deepest indentation so far in its run."""
    deepest = _by_run(lambda s, part: np.maximum.accumulate(_depth(s)[part]), s)
    return np.maximum(_depth(s) - share * deepest, 0.0) / _size(s)


def _neck(s: Signals, reach: float) -> Array:
    """Adhesion: zero before touch, one below the surface, fading over `reach` (share) above it."""
    touched = _by_run(lambda s, part: np.maximum.accumulate(s.x[part] > 0).astype(float), s)
    return np.asarray(touched * np.exp(np.minimum(s.x, 0.0) / (reach * _size(s))), dtype=np.float64)


def _since(s: Signals) -> Array:
    restarts = np.cumsum(np.maximum(-np.diff(s.t, prepend=s.t[0]), 0.0))
    return np.asarray(s.t - s.t[0] + restarts, dtype=np.float64)


@dataclass(frozen=True)
class Term:
    """One candidate law."""

    kind: str
    build: Build
    inner: tuple[float, ...] = (0.0,)


_TIMES = tuple(float(tau) for tau in np.geomspace(0.01, 300.0, 12))
_WIDTHS = (0.002, 0.01, 0.03, 0.1, 0.3)

TERMS: dict[str, Term] = {
    "stiffness": Term("elastic_shape", lambda s, p: _depth(s)),
    "power_law": Term("elastic_shape", _power, (0.3, 0.5, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0)),
    "exponential": Term(
        "elastic_shape", lambda s, p: np.expm1(p * _depth(s) / _size(s)), (2.0, 4.0, 8.0, 16.0)
    ),
    "layer": Term(
        "elastic_shape", lambda s, p: np.maximum(_depth(s) / _size(s) - p, 0.0), (0.2, 0.4, 0.6, 0.8)
    ),
    "spline": Term(
        "elastic_shape",
        lambda s, p: (
            np.stack(
                [np.maximum(_depth(s) - k, 0.0) for k in np.quantile(_depth(s), np.arange(0.05, 1.0, 0.1))],
                axis=1,
            )
            / _size(s)
        ),
    ),
    "damping": Term("rate_dependence", lambda s, p: np.where(s.x > 0, s.v, 0.0) if s.contact else s.v),
    "quadratic_rate": Term("rate_dependence", lambda s, p: s.v * np.abs(s.v)),
    "root_rate": Term(  # dry: it turns at once, and grows by less than the speed
        "friction",
        lambda s, p: np.sign(s.v) * np.abs(s.v / _speed(s)) ** p,
        (0.25, 0.5),
    ),
    "depth_rate": Term("rate_dependence", lambda s, p: _depth(s) * s.v),
    "coulomb": Term("friction", lambda s, p: np.tanh(s.v / (p * _speed(s))), (0.003, 0.02, 0.1, 0.3)),
    "asymmetric": Term(
        "friction",
        lambda s, p: np.stack([s.v > p * _speed(s), s.v < -p * _speed(s)], axis=1).astype(float),
        (0.01,),
    ),
    "presliding": Term("friction", _dahl, _WIDTHS),
    "play": Term("friction", _play, _WIDTHS),
    "play_family": Term("friction", lambda s, p: np.stack([_play(s, w) for w in _WIDTHS], axis=1)),
    "depth_friction": Term("friction", lambda s, p: np.abs(_depth(s)) * np.tanh(s.v / (0.02 * _speed(s)))),
    "relaxation": Term("time_memory", lambda s, p: _relaxed(_depth(s), s, p), _TIMES),
    "relaxation_of_square": Term("time_memory", lambda s, p: _relaxed(_depth(s) ** 2, s, p), _TIMES),
    "two_relaxations": Term(
        "time_memory",
        lambda s, p: np.stack([_relaxed(_depth(s), s, p), _relaxed(_depth(s), s, 12.0 * p)], axis=1),
        _TIMES[2:-2],
    ),
    "inertia": Term("inertia", lambda s, p: s.a),
    "ripple": Term(
        "periodic",
        lambda s, p: np.stack([np.sin(p * s.x), np.cos(p * s.x)], axis=1),
        (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 18, 20, 24, 28, 36, 42, 48, 72, 84, 100),
    ),
    "weight": Term("gravity_load", lambda s, p: np.stack([np.sin(s.x), np.cos(s.x)], axis=1)),
    "offset": Term("contact_geometry", lambda s, p: (s.x > 0).astype(float)),
    "neck": Term("contact_geometry", _neck, (0.003, 0.03, 0.1, 0.3)),
    "surface": Term(
        "contact_geometry", lambda s, p: np.maximum(s.x + p * _size(s), 0.0), (-0.1, -0.03, 0.03, 0.1, 0.3)
    ),
    "set": Term("contact_geometry", _held_max, (0.1, 0.3, 0.5, 0.7, 0.9)),
    "bias": Term("sensor_statics", lambda s, p: np.ones_like(s.x)),
    "drift": Term("drift", lambda s, p: _since(s)),
    "run_offset": Term("run_differences", lambda s, p: (s.run[:, None] == np.unique(s.run)).astype(float)),
}
_LATE = "late base"
_CONTACT_ONLY = {"offset", "neck", "surface", "set", "depth_rate"}
_REVOLUTE_ONLY = {"ripple", "weight"}


def folds_of(s: Signals) -> NDArray[np.int64]:
    """Fold of each row: up to six groups of whole runs, or of one run every fourth of twelve blocks."""
    runs = np.unique(s.run)
    if len(runs) == 1:
        return np.asarray(np.arange(len(s.run)) * 12 // len(s.run) % 4, dtype=np.int64)
    return np.asarray(np.searchsorted(runs, s.run) % min(6, len(runs)), dtype=np.int64)


def _held_out(
    columns: Array, s: Signals, fold: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[float, float]:
    """Error in the folds that were left out of the fit, and sum of the mean squares in those fitted."""
    scale = np.sqrt((columns**2).mean(axis=0))
    joint = np.column_stack([columns[rows] / np.where(scale > 0, scale, 1.0), s.effort[rows]])
    grams = [joint[fold[rows] == number].T @ joint[fold[rows] == number] for number in np.unique(fold)]
    counts = [int((fold[rows] == number).sum()) for number in np.unique(fold)]
    outside, inside = 0.0, 0.0
    for gram, count in zip(grams, counts, strict=True):
        rest = np.sum(grams, axis=0) - gram
        gains = np.linalg.lstsq(rest[:-1, :-1], rest[:-1, -1], rcond=1e-10)[0]
        weights = np.append(-gains, 1.0)
        outside += float(weights @ gram @ weights)
        inside += float(weights @ rest @ weights) / (len(rows) - count)
    return math.sqrt(max(outside, 0.0) / len(rows)), inside


def _two(column: Array) -> Array:
    return column[:, None] if column.ndim == 1 else column


class Ladder:
    """Least squares of terms, one after the other."""

    def __init__(self, s: Signals, base: list[str]) -> None:
        self.signals = s
        self.fold = folds_of(s)
        self.rows = np.unique(np.linspace(0, len(s.x) - 1, min(_ROWS, len(s.x))).astype(np.int64))
        self.columns = np.concatenate([_two(TERMS[name].build(s, 0.0)) for name in base], axis=1)
        self.error = _held_out(self.columns, s, self.fold, self.rows)[0]
        revolute = not s.contact and float(np.ptp(s.x)) > 0.5
        left_out = (set() if s.contact else _CONTACT_ONLY) | (set() if revolute else _REVOLUTE_ONLY)
        self.built = {
            name: [(p, _two(term.build(s, p))) for p in term.inner]
            for name, term in TERMS.items()
            if name not in {*base, *left_out, "run_offset"}
        }
        slopes = _by_run(lambda s, part: np.gradient(self.columns[part], s.t[part], axis=0), s)
        self.built[_LATE] = [(0.0, slopes)]  # the base model, late by a fixed time
        for name, values in s.context.items():
            self.built[f"context {name}"] = [(0.0, np.stack([values, values * s.x, values * s.v], axis=1))]

    def attempt(self, name: str) -> tuple[float, float, Array]:
        """Held-out error with a term, its inner parameter (best where it is fitted), its columns."""
        trials = []
        for p, columns in self.built[name]:
            held_out, inside = _held_out(
                np.hstack([self.columns, columns]), self.signals, self.fold, self.rows
            )
            trials.append((inside, held_out, p, columns))
        _, held_out, p, columns = min(trials, key=lambda trial: trial[0])
        return held_out, p, columns

    def of_runs(self) -> tuple[float, float]:
        """Error on odd rows where each run has an offset, and a gain, of its own, found from even rows."""
        s, rows = self.signals, self.rows
        gains = np.linalg.lstsq(self.columns[rows], s.effort[rows], rcond=1e-9)[0]
        model = self.columns[rows] @ gains
        offset, gain = [], []
        for number in np.unique(s.run):
            of_run = np.flatnonzero(s.run[rows] == number)
            even, odd = of_run[::2], of_run[1::2]
            residual = s.effort[rows] - model
            offset.append(residual[odd] - residual[even].mean())
            share = model[even] @ residual[even] / max(float(model[even] @ model[even]), 1e-300)
            gain.append(residual[odd] - share * model[odd])
        return (
            float(np.sqrt(np.concatenate([r**2 for r in offset]).mean())),
            float(np.sqrt(np.concatenate([r**2 for r in gain]).mean())),
        )


def kind_of(name: str) -> str:
    """Kind of a term."""
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
    offset, gain = ladder.of_runs()
    print(f"  alone: run offset {offset:.4g}, run gain {gain:.4g}")
    for step in range(options.steps):
        trials = sorted((ladder.attempt(name)[:2], name) for name in ladder.built)
        shown = trials[:14] if step == 0 else trials[:4]
        print(
            "  " + "; ".join(f"{name}({p:.3g}) [{kind_of(name)}] {error:.4g}" for (error, p), name in shown)
        )
        (error, p), name = trials[0]
        if error > 0.98 * ladder.error:
            break
        print(f"+ {name}({p:.3g}) [{kind_of(name)}]: {error:.4g}")
        ladder.columns = np.hstack([ladder.columns, ladder.attempt(name)[2]])
        ladder.error = error
        if len(ladder.built[name]) == 1:
            del ladder.built[name]
    offset, gain = ladder.of_runs()
    print(f"  then: run offset {offset:.4g}, run gain {gain:.4g}")


if __name__ == "__main__":
    main()
