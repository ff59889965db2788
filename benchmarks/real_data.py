"""Diagnoses measured sets, each from its simple model, beside what others found missing in them.

    python benchmarks/real_data.py DATA_DIR [SET ...] [--out FILE]

The sets are described where they come from (see docs/benchmarks.md); they are no part of this project.
A channel is right if one name of each group that its README asks for is found, alone or as
indistinguishable from another, and none that it does not know. Held-out errors stand beside the README's;
folds are the engine's own.
"""

import json
import re
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from command_line import arguments
from measured.recordings import SETS, Expected, Recording

from palpate.estimation.diagnosis import ChannelDiagnosis, diagnose


@dataclass(frozen=True)
class Judged:
    """One channel of a recording, in numbers and names."""

    recording: str
    channel: str
    verdict: str
    reason: str
    accepted: list[dict[str, Any]]
    rmse: tuple[float, float] | None
    floor: float | None
    complete: bool | None
    depends_on: list[str]
    ladder: tuple[float, ...]
    said: str
    control: bool
    named: bool
    right: bool
    missed: list[str]
    unasked: list[str]
    seconds: float


def judge(recording: str, found: ChannelDiagnosis, expected: Expected, seconds: float) -> Judged:
    """Hold one channel against its README."""
    groups = [{entry.effect, *entry.confused_with} for entry in found.accepted]
    named = found.verdict.value == "missing"
    missed = [
        "/".join(sorted(wanted))
        for wanted in expected.needed
        if not (named and any(group & wanted for group in groups))
    ]
    known = expected.allowed.union(*expected.needed)
    unasked = [entry.effect for entry, group in zip(found.accepted, groups, strict=True) if not group & known]
    return Judged(
        recording=recording,
        channel=found.channel,
        verdict=found.verdict.value,
        reason=found.reason,
        accepted=[entry.model_dump() for entry in found.accepted],
        rmse=(found.baseline.rmse, found.final.rmse) if found.baseline and found.final else None,
        floor=found.noise_floor,
        complete=found.complete,
        depends_on=found.depends_on,
        ladder=expected.ladder,
        said=expected.said,
        control=expected.is_control,
        named=named,
        right=not missed and not (named and unasked),
        missed=missed,
        unasked=unasked if named else [],
        seconds=seconds,
    )


def show(one: Judged, unit: str) -> None:
    """Print one channel, in the unit that the effort really has."""

    def say(line: str) -> None:
        print(re.sub(r" N m\b| N\b", f" {unit}", line) if unit else line)

    place = one.recording if one.channel in ("contact", "joint_1") else f"{one.recording} {one.channel}"
    complete = {None: "", True: ", complete", False: ", not complete"}[one.complete]
    print(f"\n{'right' if one.right else 'WRONG'} {place}: {one.verdict}{complete} ({one.seconds:.1f} s)")
    say(f"  literature: {one.said}; here: {one.reason}")
    if one.rmse is not None:
        ladder = " -> ".join(f"{error:.4g}" for error in one.ladder) or "of free runs, not shown"
        ratio = f", {one.rmse[1] / one.ladder[-1]:.2f} times its best" if one.ladder else ""
        floor = "" if one.floor is None else f", floor {one.floor:.4g}"
        say(f"  held-out error {one.rmse[0]:.4g} -> {one.rmse[1]:.4g}{floor}; README {ladder}{ratio}")
    for entry in one.accepted:
        values = ", ".join(
            f"{name} = {value['value']:.4g}" + (f" +- {value['std_err']:.2g}" if value["std_err"] else "")
            for name, value in entry["parameters"].items()
        )
        also = f"; or {', '.join(entry['confused_with'])}" if entry["confused_with"] else ""
        mark = "+" if one.named else "?"
        errors = f"{entry['rmse_before']:.4g} -> {entry['rmse_after']:.4g}"
        say(f"  {mark} {entry['effect']} ({values}): {errors}{also}")
    if one.depends_on:
        say(f"  the residual depends on: {', '.join(one.depends_on)}")
    for what, some in (("not found", one.missed), ("not in the README", one.unasked)):
        if some:
            say(f"  {what}: {', '.join(some)}")


def run(recording: Recording) -> list[Judged]:
    """Diagnose all channels of a recording together."""
    started = time.process_time()
    rng = np.random.default_rng(0)
    found = diagnose(recording.channels, recording.models, rng=rng, file=recording.name).channels
    seconds = time.process_time() - started
    pairs = zip(found, recording.expected, strict=True)
    return [judge(recording.name, one, expected, seconds) for one, expected in pairs]


def summary(judged: list[Judged]) -> str:
    """A recording is right if all its channels are; it is named if any channel is."""
    of: dict[str, list[Judged]] = {}
    for one in judged:
        of.setdefault(one.recording, []).append(one)
    hidden = [some for some in of.values() if not some[0].control]
    controls = [some for some in of.values() if some[0].control]
    within = [one.rmse[1] <= 1.1 * one.ladder[-1] for one in judged if one.rmse and one.ladder]
    return (
        f"right by literature {sum(all(one.right for one in some) for some in of.values())} of {len(of)}; "
        f"named in any channel {sum(any(one.named for one in some) for some in hidden)} of {len(hidden)}; "
        f"controls unnamed {sum(not some[0].named for some in controls)} of {len(controls)}; "
        f"channels right {sum(one.right for one in judged)} of {len(judged)}; "
        f"held-out error within 10 % of the README's best {sum(within)} of {len(within)}"
    )


def main() -> None:
    """Run the sets named on the command line, or all."""
    parser = arguments(__doc__)
    parser.add_argument("data_dir", type=Path)
    parser.add_argument("sets", nargs="*", metavar="SET", help=", ".join(one.__name__ for one in SETS))
    parser.add_argument("--out", type=Path, help="JSON lines, one a channel")
    options = parser.parse_args()
    unknown = set(options.sets) - {one.__name__ for one in SETS}
    if unknown:
        parser.error(f"no such set: {', '.join(sorted(unknown))}")
    judged: list[Judged] = []
    with options.out.open("w") if options.out else nullcontext() as out:
        for cases in SETS:
            if options.sets and cases.__name__ not in options.sets:
                continue
            folder = options.data_dir / cases.__name__
            if not folder.is_dir():
                print(f"\n{cases.__name__}: skipped, there is no {folder}")
                continue
            for recording in cases(folder):
                for one in run(recording):
                    judged.append(one)
                    show(one, recording.unit)
                    if out:
                        out.write(json.dumps(asdict(one)) + "\n")
    print(f"\n{summary(judged)}")


if __name__ == "__main__":
    main()
