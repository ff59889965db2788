"""Peak memory and processor time of commands on a session of very many ticks, repeated from a short one.

Run: python benchmarks/long_session.py SESSION [ticks, default 2000000] [command ...]
"""

import resource
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.robot_io.session import Session, write_session

_FORCE_NOISE_N, _TORQUE_NOISE_NM = 0.02, 0.01  # of their own, or all runs were copies
_CLOCKS = ("time_s", "encoder_at_s", "torque_at_s", "force_at_s")


def write_long(short: Session, ticks: int, path: Path, rng: np.random.Generator) -> None:
    """Write a session that repeats the ticks and events of another."""
    samples = short.samples("tick")
    times, time_s = -(-ticks // len(samples)), samples["time_s"]
    again = np.repeat(np.arange(times), len(samples))[:ticks]
    lasting_s = time_s[-1] - time_s[0] + np.median(np.diff(time_s))
    columns = {name: np.concatenate([samples[name]] * times)[:ticks] for name in samples}
    columns |= {name: columns[name] + again * lasting_s for name in _CLOCKS}
    columns["tick"] = np.arange(ticks)
    runs, run = int(samples["run"].max()) + 1, columns["run"]
    columns["run"] = np.where(run >= 0, run + again * runs, run).astype(run.dtype)
    columns["force_n"] = columns["force_n"] + rng.normal(0.0, _FORCE_NOISE_N, ticks)
    torque = columns["torque_measured_nm"]
    columns["torque_measured_nm"] = torque + rng.normal(0.0, _TORQUE_NOISE_NM, torque.shape)
    events = [
        replace(event, time_s=event.time_s + number * lasting_s)
        for number in range(times)
        for event in short.events
    ]
    write_session(path, [(samples.stream, columns)], short.metadata, events)


def main() -> None:
    """Run each command in its own process, and print what it took."""
    short, ticks, *commands = [*sys.argv[1:], "2000000"] if len(sys.argv) == 2 else sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.mcap"
        write_long(Session.open(short), int(ticks), path, np.random.default_rng(0))
        for command in commands or ["info", "compare", "diagnose"]:
            measured = (
                "import resource, sys; from palpate.main import main\n"
                "try: main()\n"
                "finally: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)"
            )
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            ran = subprocess.run(
                [sys.executable, "-P", "-c", measured, command, path],
                capture_output=True,
                text=True,
                check=False,
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            peak_gb = int(ran.stderr.split()[-1]) * 1024 / 1e9
            user_s = after.ru_utime - before.ru_utime
            print(f"{command}: peak {peak_gb:.2f} GB, {user_s:.0f} s, exit code {ran.returncode}")


if __name__ == "__main__":
    main()
