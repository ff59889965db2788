"""Small files of presses with a known law, for the commands that compare and diagnose."""

import numpy as np

STIFFNESS, DAMPING, CUBIC, NOISE_N = 400.0, 6.0, 2e6, 0.02
RATE_HZ = 250
COLUMNS = ("time_s", "displacement_m", "force_N", "run")


def press_rows(run, speed_m_s, force_of, rng):
    """One press of about 10 mm: some free air, in, hold, out, with a little noise; a smooth motion."""
    deepest, start, period = 0.010, -0.002, 1 / RATE_HZ
    travel_s = (deepest - start) / speed_m_s
    t = np.arange(0, travel_s, period)
    way = (1 - np.cos(np.pi * t / travel_s)) / 2
    rate = np.pi / 2 * (deepest - start) / travel_s * np.sin(np.pi * t / travel_s)
    rest = np.zeros(RATE_HZ // 5)
    depth = start + (deepest - start) * np.concatenate([rest, way, rest + 1, way[::-1], rest])
    rate = np.concatenate([rest, rate, rest, -rate[::-1], rest])
    force = np.where(depth > 0, np.maximum(force_of(np.maximum(depth, 0), rate), 0), 0)
    force = force + rng.normal(0, NOISE_N, len(force))
    return np.column_stack([np.arange(len(depth)) * period, depth, force, np.full(len(depth), run)])


def write_table(path, **columns):
    """A data file with columns by their names."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path


def press_columns(path):
    """Columns of a file of presses by their names."""
    return dict(zip(COLUMNS, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def write_own_effect(folder):
    """An effect of somebody's own, "mine", as it is given to commands and studies."""
    file = folder / "mine.py"
    file.write_text(
        "from palpate.estimation.effects.elastic_shape import CubicStiffness\n"
        "class Mine(CubicStiffness):\n    name = 'mine'\n"
    )
    return f"{file}:Mine"


def write_presses(path, cubic=CUBIC, speeds_m_s=(0.02, 0.04, 0.08, 0.03), force_of=None, seed=4):
    """A data file; the law is a spring and a damper, and a cubic term if there is one."""
    rng = np.random.default_rng(seed)
    law = force_of or (lambda x, v: STIFFNESS * x + DAMPING * v + cubic * x**3)
    rows = np.vstack([press_rows(run, speed, law, rng) for run, speed in enumerate(speeds_m_s)])
    form = ["%.4f", "%.9f", "%.6f", "%d"]
    np.savetxt(path, rows, delimiter=",", header=",".join(COLUMNS), comments="", fmt=form)
    return path
