"""Stiffness and damping over the paper's grid, probed on the simulated arm (paper, section VI-B)."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from control.probing.plan import ProbingPlan
from estimation.base_model import ModelContext
from estimation.estimate_channel import estimate_channel
from estimation.estimators import ESTIMATORS
from estimation.models import MODELS
from estimation.study.source import open_source
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot
from sim_backend.scenario import load_scenario

DAMPING_SCALE = 20.0  # N s/m; an error at c = 0 has no ratio to the truth and is given as a share of this
SPEEDS_M_S = (0.15, 0.09, 0.06)
FORCE_LIMIT_N = 10.0


@dataclass(frozen=True)
class Case:
    """One object of the grid with what the estimators made of it: (k, c), their standard errors, seconds."""

    stiffness: float
    damping: float
    found: dict[str, tuple[float, float]]
    std_err: dict[str, tuple[float, float]]


def probe(stiffness: float, damping: float, seed: int, folder: Path) -> Path:
    """Probe one object under the default scenario's sensors; the session file."""
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": damping}
    plan = ProbingPlan(speeds_m_s=SPEEDS_M_S, force_limit_n=FORCE_LIMIT_N, search_depth_m=0.2)
    session = folder / f"k{stiffness:.0f}_c{damping:.0f}_{seed}.mcap"
    scenario = load_scenario({"object": {"law": law}})
    run_probing(ProbingJob(find_robot("follower"), session, plan, scenario=scenario, seed=seed, online=None))
    return session


def estimate(session: Path, stiffness: float, damping: float, seed: int) -> Case:
    """Run every estimator on one session."""
    channel = open_source(session).tared()[0]
    model = MODELS["kelvin_voigt"]().build(ModelContext(surface_found=True))
    found, std_err = {}, {}
    for name in ESTIMATORS:
        rng = np.random.default_rng(seed)
        result = estimate_channel(channel, model, ESTIMATORS[name](), rng=rng)
        k, c = result["stiffness.k"], result["damping.c"]
        found[name], std_err[name] = (k.value, c.value), (k.std_err, c.std_err)
    return Case(stiffness, damping, found, std_err)


def run_grid(stiffnesses: Sequence[float], dampings: Sequence[float], seeds: int) -> list[Case]:
    """Every combination, with `seeds` noises each."""
    cases = []
    with tempfile.TemporaryDirectory() as folder:
        for stiffness in stiffnesses:
            for damping in dampings:
                for seed in range(1, seeds + 1):
                    session = probe(stiffness, damping, seed, Path(folder))
                    cases.append(estimate(session, stiffness, damping, seed))
                    session.unlink()
    return cases


def print_table(cases: list[Case]) -> None:
    """Worst and mean errors of every estimator, and how often the truth is within 2 standard errors."""
    print(f"{len(cases)} probing runs of three speeds; errors in % of the truth, worst (mean)")
    print(f"c = 0: worst absolute error [N s/m], and as % of {DAMPING_SCALE:g} N s/m\n")
    print(f"{'estimator':10s} {'k %':>16s} {'c > 0 %':>16s} {'c = 0':>20s} {'within 2 s.e. k, c':>20s}")
    for name in cases[0].found:
        k = np.array([abs(case.found[name][0] / case.stiffness - 1) for case in cases])
        off = np.array([abs(case.found[name][1] - case.damping) for case in cases])
        damping = np.array([case.damping for case in cases])
        c = off[damping > 0] / damping[damping > 0]
        zero = off[damping == 0]
        cells = (_worst(100 * k), _worst(100 * c), _zero(zero), _cover(cases, name))
        print(f"{name:10s} {cells[0]:>16s} {cells[1]:>16s} {cells[2]:>20s} {cells[3]:>20s}")
    print("\npaper, worst: RANSAC k 6.5 %, c 18.4 %; LSQ k 20.6 %, c 29.5 %")


def _worst(errors: np.ndarray) -> str:
    return f"{errors.max():.3f} ({errors.mean():.3f})" if len(errors) else "-"


def _zero(errors: np.ndarray) -> str:
    return f"{errors.max():.4f} ({100 * errors.max() / DAMPING_SCALE:.2f} %)" if len(errors) else "-"


def _cover(cases: list[Case], name: str) -> str:
    truth = np.array([(case.stiffness, case.damping) for case in cases])
    found = np.array([case.found[name] for case in cases])
    error = np.array([case.std_err[name] for case in cases])
    share = np.mean(np.abs(found - truth) <= 2 * error, axis=0)
    return f"{100 * share[0]:.0f} %, {100 * share[1]:.0f} %"
