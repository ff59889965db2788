"""The same probing runs in PyBullet and in MuJoCo: parameters, diagnosis and speed, side by side.

    python benchmarks/engines.py [--every N] [--hidden EFFECT ...]

The paper's grid without noise (every Nth object of it), then one hidden effect at a time with the diagnosis.
Whatever differs is a finding about an engine.
"""

import time
from collections.abc import Mapping
from typing import Any

from command_line import arguments
from rich.console import Console
from rich.table import Column, Table

from palpate.sweep.grid import shipped_grid
from palpate.sweep.works.probing import diagnosed, estimate, probed

ENGINES = ("pybullet", "mujoco")
HIDDEN = (
    *("none", "coulomb_friction", "stribeck_friction", "payload", "joint_elasticity", "backlash"),
    *("stress_relaxation", "cubic_stiffness", "dry_friction", "tool_compliance", "lag"),
)


def in_engine(parameters: Mapping[str, Any], engine: str) -> dict[str, Any]:
    """The same case in that engine."""
    return dict(parameters) | {"scenario": {"physics": {"engine": engine}}}


def compare_grid(console: Console, every: int) -> None:
    """Largest differences of k and c between the engines, and from the truth, for each estimator."""
    cases = list(shipped_grid("paper_clean").cases())[::every]
    worst: dict[str, dict[str, float]] = {}
    seconds, simulated = dict.fromkeys(ENGINES, 0.0), dict.fromkeys(ENGINES, 0.0)
    for case in cases:
        rows = {}
        for engine in ENGINES:
            parameters = in_engine(case.parameters, engine)
            start = time.process_time()
            ticks, _ = probed(parameters, case.seed)
            seconds[engine] += time.process_time() - start
            simulated[engine] += len(ticks) / 1000.0
            rows[engine] = {row["estimator"]: row for row in estimate(parameters, case.seed)}
        for estimator in rows["pybullet"]:
            bullet, mujoco = (rows[engine][estimator] for engine in ENGINES)
            if bullet["problem"] or mujoco["problem"]:
                continue
            found = worst.setdefault(estimator, dict.fromkeys(("k", "k bullet", "k mujoco", "c"), 0.0))
            for short, name in (("k", "stiffness.k"), ("c", "damping.c")):
                truth = bullet[f"true {name}"]
                if truth:
                    found[short] = max(found[short], abs(bullet[name] - mujoco[name]) / truth)
            truth = bullet["true stiffness.k"]
            for engine, row in (("k bullet", bullet), ("k mujoco", mujoco)):
                found[engine] = max(found[engine], abs(row["stiffness.k"] - truth) / truth)
    table = Table(
        "estimator",
        *(
            Column(text, justify="right")
            for text in ("k apart", "c apart", "PyBullet's k off", "MuJoCo's k off")
        ),
        title=f"Largest differences over {len(cases)} objects, no noise [%]",
    )
    for estimator, found in worst.items():
        table.add_row(estimator, *(f"{100 * value:.3f}" for value in found.values()))
    console.print(table)
    speeds = ", ".join(f"{engine} {simulated[engine] / seconds[engine]:.1f}" for engine in ENGINES)
    console.print(f"Probing, times faster than real time: {speeds}")


def compare_diagnoses(console: Console, hidden: list[str], seed: int) -> None:
    """What the diagnosis says of the same world in both engines."""
    table = Table("hidden", "channel", *ENGINES, "same")
    (case, *_) = shipped_grid("paper_clean").cases()
    for effect in hidden:
        parameters = dict(case.parameters) | {
            "law": {"name": "kelvin_voigt", "stiffness_n_m": 500.0, "damping_n_s_m": 20.0},
            "noise_std_n": 0.02,
            "hidden": effect,
            "plan": {"speeds_m_s": [0.15, 0.09, 0.06], "repeats": 2},
        }
        said = [
            {
                row["channel"]: f"{row['verdict']} {row['accepted']}"
                for row in diagnosed(in_engine(parameters, e), seed)
            }
            for e in ENGINES
        ]
        for channel in said[0]:
            texts = [one.get(channel, "-") for one in said]
            table.add_row(effect, channel, *texts, "yes" if texts[0] == texts[1] else "NO")
    console.print(table)


def main() -> None:
    """Parse the command line, and compare."""
    parser = arguments(__doc__)
    parser.add_argument("--every", type=int, default=1, help="every Nth object of the grid")
    parser.add_argument("--hidden", nargs="*", default=list(HIDDEN), help="effects to hide, one at a time")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    console = Console(width=150)
    compare_grid(console, options.every)
    if options.hidden:
        compare_diagnoses(console, options.hidden, options.seed)


if __name__ == "__main__":
    main()
