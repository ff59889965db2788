"""Count the probes that `palpate resolve` needs.

    python benchmarks/resolve.py --find 300 --seed 61000 --cases cases.jsonl
    python benchmarks/resolve.py --cases cases.jsonl [--first 12] [--out FILE]

`--find` hides one effect after the other in the simulated arm's world, at a random place, with 1.5 to 10
times the noise floor. It runs the short probe (two presses at 90 mm/s), and keeps the cases that remain
undecided in the channel of the effect: the answer is a group of effects, or the error is unexplained. Then
each case is resolved in that channel with at most three more probes (`--probes`).

Separated: the hidden effect, and nothing else, is named. Wrong: one other explanation is named.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import arguments, json_lines, parallel
from threadpoolctl import threadpool_limits

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.study.other_models import is_undecided
from palpate.robot_io.errors import PalpateError
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from palpate.sim_backend.hidden import noise_scale
from palpate.sim_backend.imperfection import IMPERFECTIONS, parse_imperfection
from palpate.sim_backend.scenario import Scenario
from palpate.study import Study
from palpate.workflows.resolve import ProbeDecision, StopReason, resolve

SHORT = ProbingPlan(speeds_m_s=(0.09,), repeats=2, hold_s=0.3)
WEAKEST, STRONGEST = 1.5, 10.0  # times the noise floor
SAME = {"force_deadband": "deadband"}  # the estimator's names of the simulator's effects


def screen_case(effect: str, seed: int) -> dict[str, Any] | None:
    """Return a case that the short probe leaves undecided; None if it decides."""
    rng, scale = np.random.default_rng([seed, 77]), noise_scale(Scenario())
    kind = IMPERFECTIONS[effect]
    places = [channel for channel in scale.channels if channel in kind.shows_in]
    strength = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    place = str(rng.choice(places))
    entry = kind.at_strength(strength, place, scale, rng)
    case = {"seed": seed, "hidden": entry.model_dump(mode="json") | {"effect": effect}, "channel": place}
    with TemporaryDirectory() as folder:
        job = _job(case, Path(folder) / "probe.mcap")
        run_probing(job)
        try:
            (diagnosis,) = Study(job.session, keep=False).diagnose(place).channels
        except PalpateError:
            return None
    return case | {"left": _groups(diagnosis)} if is_undecided(diagnosis) else None


def resolve_case(probes: int, case: dict[str, Any]) -> dict[str, Any]:
    """Resolve one case."""
    decisions: list[ProbeDecision] = []
    with TemporaryDirectory() as folder, threadpool_limits(1):
        job = _job(case, Path(folder) / "sessions" / "probe.mcap")
        try:
            done = resolve(job, probes, 600.0, case["channel"], decisions.append)
            end, left = str(done.end), _groups(done.channels[0])
        except PalpateError as error:
            end, left = f"stopped: {error}", [["?"]]
    hidden = case["hidden"]["effect"]
    decided = end in {"separated", "simplest"}
    right = decided and [[SAME.get(name, name) for name in group] for group in left] == [[hidden]]
    return case | {
        "end": end,
        "left": left,
        "more_probes": len(decisions) - 1,
        "seconds": sum(decision.seconds for decision in decisions[1:]),
        "separated": right,
        "wrong": decided and not right,
        "undecided_at_first": bool(decisions) and decisions[0].end is not StopReason.SEPARATED,
    }


def _job(case: dict[str, Any], session: Path) -> ProbingJob:
    scenario = Scenario().with_hidden([parse_imperfection(case["hidden"])])
    return ProbingJob(find_robot(DEFAULT), session, SHORT, scenario=scenario, seed=case["seed"], online=None)


def _groups(diagnosis: ChannelDiagnosis) -> list[list[str]]:
    return [[entry.effect, *entry.confused_with] for entry in diagnosis.accepted]


def report(done: Sequence[dict[str, Any]]) -> None:
    """Print the figures of the cases that the first probe leaves undecided."""
    done = [case for case in done if case["undecided_at_first"]]
    right = [case for case in done if case["separated"]]
    counts = [sum(case["more_probes"] <= number for case in right) for number in (1, 2, 3)]
    print(f"{len(done)} cases; separated within 1, 2, 3 more probes: {counts}; in all {len(right)}")
    print(f"  wrong: {sum(case['wrong'] for case in done)}")
    print(f"  more probes, sum over all cases: {sum(case['more_probes'] for case in done)}")
    print(f"  seconds of probing, sum over all cases: {sum(case['seconds'] for case in done):.0f}")


def main() -> None:
    """Find cases, or resolve them."""
    parser = arguments(__doc__)
    parser.add_argument("--cases", type=Path, help="JSON lines, case a case")
    parser.add_argument("--find", type=int, help="hide so many effects, and write what stays undecided")
    parser.add_argument("--seed", type=int, default=0, help="first seed of --find")
    parser.add_argument("--first", type=int, help="only so many cases")
    parser.add_argument("--probes", type=int, default=4, help="at most, the first among them")
    parser.add_argument("--out", type=Path, help="JSON lines, case a case")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.find:
        shown = set(noise_scale(Scenario()).channels)
        names = [name for name, kind in IMPERFECTIONS.items() if shown & set(kind.shows_in)]
        jobs = [(names[n % len(names)], options.seed + n) for n in range(options.find)]
        with json_lines(options.cases, "a") as write:
            for case in filter(None, parallel(screen_case, jobs, options.processes)):
                write(case)
        return
    cases = [json.loads(line) for line in options.cases.read_text(encoding="utf-8").splitlines()]
    jobs, done = [(options.probes, case) for case in cases[: options.first]], []
    with json_lines(options.out, "a") as write:
        for case in parallel(resolve_case, jobs, options.processes):
            done.append(case)
            word = "separated" if case["separated"] else "WRONG" if case["wrong"] else case["end"]
            print(word, *(case[key] for key in ("hidden", "more_probes", "left")), sep=" | ")
            write(case)
    report(done)


if __name__ == "__main__":
    main()
