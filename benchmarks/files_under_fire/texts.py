"""Robot files, worlds, plans and URDFs that are wrong in one place, or altogether."""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from files_under_fire.case import Case, Rng, pick
from files_under_fire.hostile import TEXTS, URDFS
from palpate.runs.robots import DEFAULT, find_robot
from sim_backend.scenario import Scenario

VALUES = (
    *(None, "", -1, 0, 1e999, float("nan"), 10**30, "x" * 5000, [], {}, [[]], True, "\x1b[2J", 1e-300),
    *("1,5", "../.."),
)
QUICK = ["--speed-mm-s", "150", "--hold-s", "0.1", "--online", "none"]


def case(folder: Path, rng: Rng) -> Case:
    """A hostile file and a command that reads it."""
    kind = pick(rng, ("robot", "scenario", "plan", "hidden", "urdf"))
    file, session = folder / "file.yaml", str(folder / "s.mcap")
    if kind == "urdf":
        data = folder / "joint.csv"
        rows = [f"{n * 0.01:.2f},{np.sin(n * 0.05):.6f},{np.cos(n * 0.05):.6f}" for n in range(400)]
        data.write_text("\n".join(["time_s,position_rad,torque_Nm", *rows]))
        text = pick(rng, URDFS)
        file.write_text(text, encoding="utf-8", errors="surrogatepass")
        return Case("urdf", ["estimate", str(data), "--model", "rigid_body", "--urdf", str(file)])
    whole = rng.random() < 0.4
    text = pick(rng, TEXTS) if whole else _wrong_in_one_place(kind, rng)
    file.write_text(text, encoding="utf-8", errors="surrogatepass")
    option = {"robot": "--robot", "scenario": "--scenario", "plan": "--experiment", "hidden": "--hidden"}[
        kind
    ]
    quick = [] if kind == "plan" else QUICK
    return Case(
        f"{kind}: {text[:60]!r}" if whole else kind, ["probe", option, str(file), *quick, "-o", session]
    )


def _wrong_in_one_place(kind: str, rng: Rng) -> str:
    tree: Any
    if kind == "robot":
        document = find_robot(DEFAULT).document
        tree = yaml.safe_load(document.text)
        tree |= {key: str(Path(document.origin).parent / tree[key]) for key in ("urdf", "dh")}
    elif kind == "scenario":
        tree = Scenario().model_dump(mode="json")
    elif kind == "plan":
        tree = {"speeds_m_s": [0.15], "force_limit_n": 5.0, "hold_s": 0.1, "repeats": 1}
    else:
        tree = [
            {"effect": "coulomb_friction", "joint": 1, "coulomb_nm": 0.2},
            {"effect": "drift", "channel": "contact"},
        ]
    holder, key = pick(rng, list(_places(tree)))
    value, chance = pick(rng, VALUES), rng.random()
    if chance < 0.7:
        holder[key] = value
    elif chance < 0.85:
        del holder[key]
    elif isinstance(holder, dict):
        holder[random.Random(int(rng.integers(99))).choice(["unknown", "\x1b[2J", 3, "<<"])] = value
    return yaml.safe_dump(tree)


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401
    """Every place in nested lists and mappings: what holds it, and its key there."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])
