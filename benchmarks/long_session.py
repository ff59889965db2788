"""Measure peak memory and processor time of commands on a very long session, made by repeating a short one.

Run: python benchmarks/long_session.py SESSION [ticks, default 2000000] [command ...]
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from harness import arguments, run_palpate

from palpate.robot_io.session import Session, write_session

_NOISE = {"force_n": 0.02, "torque_measured_nm": 0.01}  # otherwise all runs would be copies
_CLOCKS = ("time_s", "encoder_at_s", "torque_at_s", "force_at_s")


def write_long(short: Session, ticks: int, path: Path, rng: np.random.Generator) -> None:
    """Write a session that repeats the ticks and events of another."""
    samples = short.samples("tick")
    times, time_s = -(-ticks // len(samples)), samples["time_s"]
    again = np.repeat(np.arange(times), len(samples))[:ticks]
    lasting_s = time_s[-1] - time_s[0] + np.median(np.diff(time_s))
    columns = {name: np.concatenate([samples[name]] * times)[:ticks] for name in samples}
    columns |= {name: columns[name] + again * lasting_s for name in _CLOCKS}
    columns |= {name: columns[name] + rng.normal(0.0, s, columns[name].shape) for name, s in _NOISE.items()}
    columns["tick"] = np.arange(ticks)
    runs, run = int(samples["run"].max()) + 1, columns["run"]
    columns["run"] = np.where(run >= 0, run + again * runs, run).astype(run.dtype)
    events = [
        replace(event, time_s=event.time_s + number * lasting_s)
        for number in range(times)
        for event in short.events
    ]
    write_session(path, [(samples.stream, columns)], short.metadata, events)


def main() -> None:
    """Run each command in its own process, and print its memory and time."""
    parser = arguments(__doc__)
    parser.add_argument("session")
    parser.add_argument("ticks", nargs="?", type=int, default=2_000_000)
    parser.add_argument("commands", nargs="*", default=["info", "compare", "diagnose"])
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "long.mcap"
        write_long(Session.open(given.session), given.ticks, path, np.random.default_rng(0))
        for command in given.commands:
            ended = run_palpate(command, path, check=False)
            took = f"peak {ended.peak_gb:.2f} GB, {ended.processor_s:.0f} s"
            print(f"{command}: {took}, exit code {ended.exit_code}")


if __name__ == "__main__":
    main()
