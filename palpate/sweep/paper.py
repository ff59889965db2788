"""The paper's study: its figures and tables, from probing runs of the simulated arm, beside its own numbers.

"Compliance Estimation during Bilateral Teleoperation of a Robotic Arm".
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from palpate.sweep import paper_sections as sections
from palpate.sweep.case import Case, Row
from palpate.sweep.grid import shipped_grid
from palpate.sweep.page import write_page
from palpate.sweep.paper_sections import RANSAC_NOISES

_THRESHOLDS_N = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_SUBSETS = (2, 5, 10, 20, 50)
_TRIALS = (1, 10, 100, 1000)
_TICKS = "palpate.sweep.works.probing:ticks"
_PAPER_RANSAC = {"name": "ransac", "threshold": 0.01, "label": "ransac"}  # [N], section VI-B
_RANSAC = "palpate.sweep.works.ransac_map:ransac_errors"


def paper_cases() -> dict[str, list[Case]]:
    """All cases of the study, part by part."""
    names = ("grid", "clean", "noise", "cubes", "hunt_crossley")
    parts = {name: list(map(_as_in_paper, shipped_grid(f"paper_{name}").cases())) for name in names}
    object_4a = parts["noise"][0].parameters  # k = 500, c = 100
    ransac = []
    settings = product(RANSAC_NOISES, _THRESHOLDS_N, _SUBSETS, _TRIALS)
    for (percent, outliers), threshold, subset, trials in settings:
        own: dict[str, Any] = {"noise_percent": percent, "outliers_percent": outliers, "draws": 10}
        own |= {"settings": {"threshold": threshold, "subset": subset, "trials": trials}}
        ransac.append(Case(_RANSAC, dict(object_4a) | own, seed=1))
    return {"ticks": [Case(_TICKS, object_4a, seed=1)], **parts, "ransac": ransac}


def _as_in_paper(case: Case) -> Case:
    """The case with RANSAC's threshold as in the paper."""
    estimators = [_PAPER_RANSAC if spec == "ransac" else spec for spec in case.parameters["estimators"]]
    return replace(case, parameters=dict(case.parameters) | {"estimators": estimators})


def write_paper(folder: Path, parts: Mapping[str, Sequence[Row]], facts: Mapping[str, str]) -> Path:
    """Write figures, tables and the page of the study; returns the page.

    Args:
        folder: where to.
        parts: rows of each part of `paper_cases`.
        facts: to stand at the page's head.

    Raises:
        InputError: a file cannot be written.
    """
    made = [
        sections.controller_section(parts["ticks"]),
        sections.transition_section(parts["ticks"]),
        sections.force_section(parts["ticks"], parts["grid"]),
        sections.grid_section(parts["grid"], parts["clean"]),
        sections.noise_section(parts["noise"]),
        sections.cubes_section(parts["cubes"]),
        sections.ransac_section(parts["ransac"]),
        sections.hunt_crossley_section(parts["hunt_crossley"]),
    ]
    return write_page(folder, "The paper's study, rerun", _SUMMARY, facts, made)


_SUMMARY = (
    "“Compliance Estimation during Bilateral Teleoperation of a Robotic Arm”, rerun on the simulated arm: "
    "every figure and table of its results that a simulation can give, the paper's numbers beside ours. "
    "The paper's simulator, sensors and exact values of k and c are not published, so what differs says "
    "how this chain does under the paper's conditions, not by how much one method beats another on equal "
    "data; that is what the columns “over bound” are for: the root mean square error over the least that "
    "any unbiased estimator can have with this noise (Cramér-Rao), the surface being unknown as well."
)
