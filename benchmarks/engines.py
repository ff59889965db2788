"""Compare parameters and diagnoses of the same probing runs in PyBullet and in MuJoCo.

    python benchmarks/engines.py [--every N] [--hidden [EFFECT ...]]

The first part is the paper's grid without noise, each object at its three speeds. The second part is the
default object with each hidden effect of the simulator, and the diagnosis of the channels that contain it.
World, noise and hidden effects are the same in both engines, so a difference is an error of one engine.
"""

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import arguments

from palpate.control.probing.plan import ProbingPlan
from palpate.render.progress import sweep_progress
from palpate.sim_backend.hidden import draw_hidden, noise_scale
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.noise_scale import CONTACT
from palpate.sim_backend.scenario import Scenario
from palpate.sweep import Case, Cluster, ResultStore, run_cases
from palpate.sweep.grid import DIAGNOSE, SHIPPED, load_grid
from palpate.sweep.tasks.probing import NOTHING

ENGINES = ("pybullet", "mujoco")
Row = Mapping[str, Any]
UNSEEN = 20.0  # strength of an effect that no probing run shows, over the noise


def diagnosis_case(effect: str, seed: int) -> Case:
    """Build the case of the default object and plan with one hidden effect, or none.

    The seed determines place and strength; an effect that no probing run shows gets a fixed place and
    strength.
    """
    world, hidden = Scenario(), []
    if effect != NOTHING:
        kind = IMPERFECTIONS[effect]
        place, rng = "joint_1" if "joint" in kind.model_fields else CONTACT, np.random.default_rng(seed)
        if kind.shows_in:
            hidden = draw_hidden(seed, effect=effect, scenario=world)
        else:
            hidden = [kind.at_strength(UNSEEN, place, noise_scale(world), rng)]
    judged = [channel for entry in hidden for channel in entry.channels]
    parameters: dict[str, Any] = {
        "robot": "follower",
        "scenario": "default",
        "law": world.model_dump()["object"]["law"],
        "plan": {"speeds_m_s": list(ProbingPlan().speeds_m_s)},
        "noise_std_n": world.sensors.force.noise_std_n,
        "noise_percent": 0,
        "hidden": [entry.describe() for entry in hidden],
        "model": "kelvin_voigt",
    }
    return Case(DIAGNOSE, parameters | ({"channels": judged} if judged else {}), seed)


def run_in_both_engines(cases: Sequence[Case], options: Namespace) -> Iterator[tuple[list[Row], list[Row]]]:
    """Return the rows of each case in the first and in the second engine."""
    pairs = [
        replace(case, parameters={**case.parameters, "engine": name}) for case in cases for name in ENGINES
    ]
    with ExitStack() as stack:
        store = ResultStore(options.results or Path(stack.enter_context(TemporaryDirectory())))
        run_cases(pairs, store, Cluster(workers=options.processes), stack.enter_context(sweep_progress()))
        rows = [store.rows([case.address]) for case in pairs]
    for row in (row for case_rows in rows for row in case_rows if row["error"]):
        raise SystemExit(row["error"])
    yield from zip(rows[::2], rows[1::2], strict=True)


def compare_grid(options: Namespace) -> None:
    """Print the largest difference of k and c between the engines, for each estimator."""
    cases = list(load_grid(SHIPPED / "paper_clean.yaml").cases())[:: options.every]
    apart: dict[tuple[str, str], list[float]] = {}
    for rows in run_in_both_engines(cases, options):
        for bullet, mujoco in zip(*rows, strict=True):
            for name in ("stiffness.k", "damping.c"):
                truth = bullet[f"true {name}"]
                if truth and not (bullet["problem"] or mujoco["problem"]):
                    percent = 100.0 * abs(bullet[name] - mujoco[name]) / truth
                    apart.setdefault((bullet["estimator"], name), []).append(percent)
    print(f"Largest difference over {len(cases)} objects without noise, in percent of the true value")
    for (estimator, name), percents in apart.items():
        print(f"  {estimator:24}{name:14}{max(percents):8.3f} % of {len(percents)} objects")


def compare_diagnoses(options: Namespace) -> None:
    """Print how often the diagnosis is the same in both engines."""
    same: list[bool] = []
    cases = [diagnosis_case(effect, options.seed) for effect in options.hidden]
    for effect, rows in zip(options.hidden, run_in_both_engines(cases, options), strict=True):
        for bullet, mujoco in zip(*rows, strict=True):
            answers = [f"{row['verdict']} {row['accepted']}".strip() for row in (bullet, mujoco)]
            same.append(answers[0] == answers[1])
            if not same[-1]:
                print(f"{effect}, {bullet['channel']}: {' | '.join(answers)}")
    print(f"Same verdict and names in {sum(same)} of {len(same)} channels")


def main() -> None:
    """Parse the command line, and compare."""
    parser = arguments(__doc__)
    parser.add_argument("--every", type=int, default=1, help="every Nth object of the grid")
    parser.add_argument("--hidden", nargs="*", default=[NOTHING, *IMPERFECTIONS], help="effects to hide")
    parser.add_argument("--seed", type=int, default=1, help="of noise, place and strength")
    parser.add_argument("--results", type=Path, help="folder of results to continue from")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    compare_grid(options)
    compare_diagnoses(options)


if __name__ == "__main__":
    main()
