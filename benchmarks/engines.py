"""The same probing runs in PyBullet and in MuJoCo: parameters and diagnosis, side by side.

    python benchmarks/engines.py [--every N] [--fine-sensors] [--hidden [EFFECT ...]] [--all-channels]

The paper's grid, each object at its three speeds without noise; then the default object with each hidden
effect of the simulator in turn, and the diagnosis of the channels that it is in. Effects that no probing run
shows are hidden as well. World, noise and what is hidden are the same in both engines: a difference is a
finding about one.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from command_line import arguments
from rich.console import Console
from rich.table import Column, Table

from palpate.control.probing.plan import ProbingPlan
from palpate.render.progress import sweep_progress
from palpate.sim_backend.hidden import draw_hidden, noise_scale
from palpate.sim_backend.imperfection import IMPERFECTIONS, Imperfection, describe_imperfection
from palpate.sim_backend.noise_scale import CONTACT
from palpate.sim_backend.scenario import Scenario
from palpate.sweep import Case, Cluster, ResultStore, run_cases
from palpate.sweep.grid import DIAGNOSE, shipped_grid
from palpate.sweep.works.probing import NOTHING

ENGINES = ("pybullet", "mujoco")
FINE = {
    "encoder": {"counts_per_revolution": 1e10},
    "force": {"resolution_n": 1e-7},
    "torque": {"noise_std_nm": 0.0, "resolution_nm": 1e-9, "command_resolution_nm": 1e-9},
}
"""Sensors without noise, whose steps are too small to count."""
Row = Mapping[str, Any]
UNSEEN = 20.0  # strength of an effect that no probing run shows, over the noise


def in_both(case: Case) -> tuple[Case, Case]:
    """The same case in either engine."""
    first, second = (replace(case, parameters={**case.parameters, "engine": name}) for name in ENGINES)
    return first, second


def hidden_at(effect: str, seed: int) -> Imperfection:
    """An effect whose place and strength the seed decides; one that no probing run shows is put somewhere."""
    kind, world = IMPERFECTIONS[effect], Scenario()
    if kind.shows_in:
        (drawn,) = draw_hidden(seed, effect=effect, scenario=world)
        return drawn
    place = "joint_1" if "joint" in kind.model_fields else CONTACT
    return kind.at_strength(UNSEEN, place, noise_scale(world), np.random.default_rng(seed))


def diagnosis_case(effect: str, seed: int, *, all_channels: bool) -> Case:
    """The default object and plan, with one effect hidden, or nothing."""
    world, plan = Scenario(), ProbingPlan()
    hidden = [] if effect == NOTHING else [hidden_at(effect, seed)]
    judged = [] if all_channels else [channel for entry in hidden for channel in entry.channels]
    parameters: dict[str, Any] = {
        "robot": "follower",
        "scenario": "default",
        "law": world.model_dump()["object"]["law"],
        "plan": {"speeds_m_s": list(plan.speeds_m_s)},
        "noise_std_n": world.sensors.force.noise_std_n,
        "noise_percent": 0,
        "hidden": [describe_imperfection(entry) for entry in hidden],
        "model": "kelvin_voigt",
    }
    return Case(DIAGNOSE, parameters | ({"channels": judged} if judged else {}), seed)


def of_pairs(
    pairs: Sequence[tuple[Case, Case]], options: argparse.Namespace
) -> Iterator[tuple[list[Row], list[Row]]]:
    """Rows of each pair of cases; results that are in the folder already are not computed again."""
    cases = [case for pair in pairs for case in pair]
    with ExitStack() as stack:
        store = ResultStore(options.results or Path(stack.enter_context(TemporaryDirectory())))
        cluster = Cluster(workers=options.processes)
        run_cases(cases, store, cluster, stack.enter_context(sweep_progress()))
        rows = [store.rows([case.address]) for case in cases]
    for row in (row for case_rows in rows for row in case_rows if row["error"]):
        raise SystemExit(row["error"])
    yield from zip(rows[::2], rows[1::2], strict=True)


def compare_grid(console: Console, options: argparse.Namespace) -> None:
    """Largest differences of k and c between the engines, and from the truth, for each estimator."""
    cases = list(shipped_grid("paper_clean").cases())[:: options.every]
    if options.fine_sensors:
        fine = {"scenario": {"sensors": FINE}}
        cases = [replace(case, parameters={**case.parameters, **fine}) for case in cases]
    apart: dict[str, list[dict[str, float]]] = {}
    for rows in of_pairs([in_both(case) for case in cases], options):
        for bullet, mujoco in zip(*rows, strict=True):
            pairs = apart.setdefault(bullet["estimator"], [])
            if not (bullet["problem"] or mujoco["problem"]):
                pairs.append(differences(bullet, mujoco))
    headers = ("k apart", "c apart", "k off", "c off", "c apart at c = 0", "objects")
    table = Table(
        "estimator",
        *(Column(text, justify="right") for text in headers),
        title=f"Largest of {len(cases)} objects without noise [% of the truth; at c = 0 N s/m]",
    )
    for estimator, pairs in apart.items():
        worst = {key: max(pair[key] for pair in pairs) for key in pairs[0]} if pairs else {}
        table.add_row(estimator, *(f"{value:.3f}" for value in worst.values()), f"{len(pairs)}")
    console.print(table)


def differences(bullet: Row, mujoco: Row) -> dict[str, float]:
    """How far k and c are apart, and at most off the truth [%]; c of an object without damping [N s/m]."""
    k, c = ("stiffness.k", "damping.c")

    def share(name: str) -> tuple[float, float]:
        truth, values = bullet[f"true {name}"], (bullet[name], mujoco[name])
        if not truth:
            return 0.0, 0.0
        off = max(abs(value - truth) for value in values)
        return 100.0 * abs(values[0] - values[1]) / truth, 100.0 * off / truth

    undamped = 0.0 if bullet[f"true {c}"] else abs(bullet[c] - mujoco[c])
    (k_apart, k_off), (c_apart, c_off) = share(k), share(c)
    return {"k apart": k_apart, "c apart": c_apart, "k off": k_off, "c off": c_off, "undamped": undamped}


def compare_diagnoses(console: Console, options: argparse.Namespace) -> None:
    """What the diagnosis says of the same world in both engines."""
    pairs = [
        in_both(diagnosis_case(effect, options.seed, all_channels=options.all_channels))
        for effect in options.hidden
    ]
    table, same, channels, alike = Table("hidden", *ENGINES, "same"), 0, 0, 0
    for effect, rows in zip(options.hidden, of_pairs(pairs, options), strict=True):
        bullet, mujoco = ({row["channel"]: in_words(row) for row in of_engine} for of_engine in rows)
        agreed = bullet == mujoco
        same += agreed
        channels += len(bullet)
        alike += sum(mujoco.get(channel) == text for channel, text in bullet.items())
        table.add_row(effect, told(bullet), told(mujoco), "yes" if agreed else "NO")
    console.print(table)
    console.print(f"Same verdict and names: {same} of {len(pairs)} sessions, {alike} of {channels} channels")


def in_words(row: Row) -> str:
    """Verdict and names of a channel."""
    rest = "" if row["complete"] or row["verdict"] != "missing" else ", and more"
    return f"{row['verdict']} {row['accepted']}{rest}".strip()


def told(of_channels: Mapping[str, str]) -> str:
    """What was said, without the channels in which all is well."""
    said = [f"{channel}: {text}" for channel, text in of_channels.items() if text != "adequate"]
    return "; ".join(said) or "all adequate"


def main() -> None:
    """Parse the command line, and compare."""
    parser = arguments(__doc__)
    parser.add_argument("--every", type=int, default=1, help="every Nth object of the grid")
    effects = [NOTHING, *IMPERFECTIONS]
    parser.add_argument("--fine-sensors", action="store_true", help="the grid with sensors without steps")
    parser.add_argument("--hidden", nargs="*", default=effects, help="effects to hide, one at a time")
    parser.add_argument("--all-channels", action="store_true", help="diagnose the other channels as well")
    parser.add_argument("--seed", type=int, default=1, help="of noise, place and strength")
    parser.add_argument("--results", type=Path, help="folder of results, to go on from; default: a new one")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    console = Console(width=150)
    compare_grid(console, options)
    if options.hidden:
        compare_diagnoses(console, options)


if __name__ == "__main__":
    main()
