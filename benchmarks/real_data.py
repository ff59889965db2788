"""Diagnose published measurements from their simple models, and compare with what their authors found.

    python benchmarks/real_data.py DATA_DIR [SET ...] [--out FILE]

docs/benchmarks.md names the origin of the sets, which are not part of this project. A channel is right if one
name of each group that its README asks for is accepted, alone or as indistinguishable from another, and no
accepted name is unknown to it. The README's held-out errors are printed for comparison; folds differ.
"""

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from harness import arguments, json_lines
from measured.recordings import SETS, Expected, Recording, recordings

from palpate.estimation.diagnosis import ChannelDiagnosis, diagnose


@dataclass(frozen=True)
class JudgedChannel:
    """One channel of a recording, and whether its diagnosis is right."""

    recording: str
    channel: str
    verdict: str
    reason: str
    rmse: tuple[float, float] | None  # held out, of the simple and of the final model
    ladder: tuple[float, ...]  # held-out errors in the README
    literature: str
    named: bool
    missed: list[str]  # groups of which no name was accepted
    unasked: list[str]  # accepted names that the README does not list
    seconds: float  # processor time of the recording

    @property
    def right(self) -> bool:
        """Whether the diagnosis agrees with the literature."""
        return not (self.missed or self.unasked)


def judge(recording: str, found: ChannelDiagnosis, expected: Expected, seconds: float) -> JudgedChannel:
    """Compare one channel with its README."""
    named = found.verdict.value == "missing"
    groups = [{entry.effect, *entry.confused_with} for entry in found.accepted] if named else []
    known = expected.allowed.union(*expected.needed)
    return JudgedChannel(
        recording=recording,
        channel=found.channel,
        verdict=found.verdict.value,
        reason=found.reason,
        rmse=(found.baseline.rmse, found.final.rmse) if found.baseline and found.final else None,
        ladder=expected.ladder,
        literature=expected.said,
        named=named,
        missed=["/".join(sorted(names)) for names in expected.needed if not any(g & names for g in groups)],
        unasked=[
            entry.effect for entry, group in zip(found.accepted, groups, strict=False) if not group & known
        ],
        seconds=seconds,
    )


def show(channel: JudgedChannel) -> None:
    """Print one channel."""
    mark = "right" if channel.right else "WRONG"
    print(f"\n{mark} {channel.recording} {channel.channel}: {channel.verdict} ({channel.seconds:.1f} s)")
    print(f"  literature: {channel.literature}; here: {channel.reason}")
    if channel.rmse is not None:
        ladder = " -> ".join(f"{error:.4g}" for error in channel.ladder) or "of free runs, not shown"
        print(f"  held-out error {channel.rmse[0]:.4g} -> {channel.rmse[1]:.4g}; README {ladder}")
    for what, names in (("not named", channel.missed), ("not in the README", channel.unasked)):
        if names:
            print(f"  {what}: {', '.join(names)}")


def run(recording: Recording) -> list[JudgedChannel]:
    """Diagnose all channels of a recording together."""
    started = time.process_time()
    rng = np.random.default_rng(0)
    channels = diagnose(recording.channels, recording.models, rng=rng, file=recording.name).channels
    seconds = time.process_time() - started
    pairs = zip(channels, recording.expected, strict=True)
    return [judge(recording.name, channel, expected, seconds) for channel, expected in pairs]


def summary(judged: list[JudgedChannel]) -> str:
    """Count right channels, and recordings of which all channels are right."""
    recordings = {channel.recording for channel in judged}
    wrong = {channel.recording for channel in judged if not channel.right}
    named = {channel.recording for channel in judged if channel.named}
    within = [entry.rmse[1] <= 1.1 * entry.ladder[-1] for entry in judged if entry.rmse and entry.ladder]
    return (
        f"recordings right by literature {len(recordings - wrong)} of {len(recordings)}; "
        f"an effect named in {len(named)}; "
        f"channels right {sum(channel.right for channel in judged)} of {len(judged)}; "
        f"held-out error within 10 % of the README's best {sum(within)} of {len(within)}"
    )


def main() -> None:
    """Run the sets named on the command line, or all."""
    parser = arguments(__doc__)
    parser.add_argument("data_dir", type=Path)
    parser.add_argument("sets", nargs="*", metavar="SET", help=", ".join(SETS))
    parser.add_argument("--out", type=Path, help="JSON lines, one a channel")
    options = parser.parse_args()
    if unknown := set(options.sets) - set(SETS):
        parser.error(f"no such set: {', '.join(sorted(unknown))}")
    judged: list[JudgedChannel] = []
    with json_lines(options.out) as write:
        for name in (name for name in SETS if name in (options.sets or SETS)):
            folder = options.data_dir / name
            if not folder.is_dir():
                print(f"\n{name}: skipped, there is no {folder}")
                continue
            for channel in (channel for recording in recordings(folder) for channel in run(recording)):
                judged.append(channel)
                show(channel)
                write(asdict(channel))
    print(f"\n{summary(judged)}")


if __name__ == "__main__":
    main()
