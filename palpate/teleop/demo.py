"""Run leader and follower as two processes on this machine, with a scripted operator."""

import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import yaml

from palpate.common.console import count
from palpate.common.failures import INTERRUPTED
from palpate.common.files import output_file, output_folder, write_text
from palpate.robot_io.errors import PalpateError
from palpate.robot_io.session import Session
from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.scenario import ObjectSettings, Scenario
from palpate.teleop.merged_sessions import TOUCH_S, ForceComparison, MergedSessions, merge_sessions
from palpate.teleop.recording import draw, record_both

_GUESS = KelvinVoigtLaw(stiffness_n_m=300.0, damping_n_s_m=5.0)  # object before the first estimate
_GUESS_ABOVE_M = 0.003  # height of its surface above the real surface [m]
_START_S = 60.0  # time for both sides to start [s]
_LIMIT_S = 44.0  # time from then until both sides are stopped, so that the demo takes about a minute [s]
_END_S = 30.0  # time for both sides to end after that [s]
_POLL_S = 0.1
_TOO_SLOW, _AGAIN = "This machine was too slow", "End other programs and repeat the demo."
_PLACES_M = (0.36, 0.40)  # x of the targets
_ABOVE_M, _BELOW_M = 0.03, 0.02  # hand's rest position above the surface, and its goal below the surface
# Durations of pressing, for 60 to 120 mm/s, and of holding [s].
_PRESSES = ((1.0, 0.5), (0.8, 0.4), (1.5, 0.3))
_LAST_S = 16.0
_SIDES = ("follower", "leader")


@dataclass(frozen=True)
class TeleopDemo:
    """Results of the demo."""

    merged: MergedSessions
    rendered: ForceComparison  # felt force, and force of the real object
    modeled: ForceComparison  # force of the models in the follower's presses, and measured force
    files: dict[str, Path]
    ended_early: bool = False  # whether the leader was stopped before the end of the operator's script

    def slowness_summary(self) -> str:
        """Describe the parts for which this machine was too slow; empty if it was fast enough."""
        clauses = self.merged.slowness()
        if self.ended_early:
            clauses.append(f"the leader was stopped after {_LIMIT_S:g} s, before the operator's script ended")
        if not clauses:
            return ""
        return (
            f"{_TOO_SLOW}: {'; '.join(clauses)}. The figures describe the machine, not the "
            f"teleoperation. {_AGAIN}"
        )

    def force_summary(self) -> str:
        """Describe the difference between felt and real force."""
        if not len(self.rendered.real_n):
            return "there was no touch after the first estimate, so the felt force cannot be compared"
        settled, stalled = self.rendered.settled(), int(self.rendered.stalled.sum())
        late = f" and {count(stalled, 'sample')} of touches that began while the machine missed ticks"
        return (
            f"felt force: differs from the real force by {100.0 * settled.share:.2g} % rms after the first "
            f"estimate. This figure excludes the first {1e3 * TOUCH_S:g} ms of every touch (passivity then "
            f"withholds part of the damper's force){late if stalled else ''}. In all samples, the difference "
            f"is {100.0 * self.rendered.share:.2g} %"
        )


def script(surface_m: float, last_s: float = _LAST_S) -> dict[str, object]:
    """Make the operator's script: choose two places, then press on both until the end."""
    high_m, low_m = surface_m + _ABOVE_M, surface_m - _BELOW_M
    path: list[dict[str, object]] = []
    at_s = 0.0

    def go(x_m: float, z_m: float, after_s: float, *, select: bool = False) -> None:
        nonlocal at_s
        at_s += after_s
        path.append({"time_s": round(at_s, 3), "position_world_m": [x_m, 0.0, z_m], "select": select})

    go(_PLACES_M[0], high_m, 0.0)
    for x_m in _PLACES_M:
        go(x_m, high_m, 0.6)
        go(x_m, high_m, 0.2, select=True)
        go(x_m, high_m, 0.2)
    number = 0
    while at_s < last_s:
        x_m = _PLACES_M[number // len(_PRESSES) % len(_PLACES_M)]
        down_s, hold_s = _PRESSES[number % len(_PRESSES)]
        for z_m, after_s in ((high_m, 0.4), (low_m, down_s), (low_m, hold_s), (high_m, down_s)):
            go(x_m, z_m, after_s)
        number += 1
    return {"device": "scripted", "path": path}


def write_worlds(folder: Path, real: Scenario) -> None:
    """Write the follower's world as real.yaml, and the leader's as guess.yaml, softer and higher.

    Args:
        folder: existing folder.
        real: the follower's world.

    Raises:
        InputError: they cannot be written.
    """
    surface_m = real.object.surface_height_m + _GUESS_ABOVE_M
    guess = Scenario(description="a guess", object=ObjectSettings(law=_GUESS, surface_height_m=surface_m))
    for name, world in {"real": real, "guess": guess}.items():
        write_text(folder / f"{name}.yaml", world.to_yaml())


def run_demo(folder: Path, real: Scenario, further: Sequence[str] = ()) -> TeleopDemo:
    """Run both sides, and evaluate their sessions.

    Args:
        folder: destination of all files.
        real: world of the follower.
        further: further options of both sides.

    Raises:
        InputError: a file already exists.
        PalpateError: a side failed; its log states the reason.
    """
    output_folder(folder)
    sessions = {side: output_file(folder / f"{side}.mcap") for side in _SIDES}
    operator = folder / "operator.yaml"
    write_text(operator, yaml.safe_dump(script(real.object.surface_height_m), sort_keys=False))
    write_worlds(folder, real)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    commands = {
        "follower": ["--scenario", str(folder / "real.yaml")],
        "leader": ["--scenario", str(folder / "guess.yaml"), "--operator", str(operator)],
    }
    for side, options in commands.items():
        options += ["--port", port, "-o", str(sessions[side]), *further]
    with tempfile.TemporaryDirectory() as own:  # a folder that other users cannot read
        key = Path(own, "pair.key")
        key.touch(0o600)
        key.write_bytes(secrets.token_bytes(32))
        for options in commands.values():
            options += ["--key", str(key)]
        ended_early = _run_both(folder, commands)
    merged = merge_sessions(*(Session.open(path) for path in sessions.values()))
    rendered, modeled = merged.compare_rendered_to_real(real), merged.compare_modeled_to_measured()
    files = {**sessions, "recording": folder / "teleop.rrd", "figures": folder / "figures.png"}
    record_both(merged, files["recording"])
    draw(files["figures"], merged, rendered, modeled)
    return TeleopDemo(merged, rendered, modeled, files, ended_early)


def _wait_for_ends(running: Mapping[str, subprocess.Popen[bytes]], valid: set[int], folder: Path) -> None:
    """Wait until both sides end; raise the follower's error first, because the leader depends on it."""
    failures = list[str]()
    for side in reversed(_SIDES):
        log = folder / f"{side}.log"
        try:
            code = running[side].wait(_END_S)
        except subprocess.TimeoutExpired:
            late = f"the {side} did not end within {_END_S:g} s (see {log})"
            raise PalpateError(f"{_TOO_SLOW}: {late}. {_AGAIN}") from None
        if code not in valid:
            lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            failures.append(f"the {side} failed: {lines[-1] if lines else f'without a message (see {log})'}")
    if failures:
        raise PalpateError(failures[-1])


def _run_both(folder: Path, commands: dict[str, list[str]]) -> bool:
    """Run both sides to their end; return whether the leader had to be interrupted."""
    program = [sys.executable, "-P", "-m", "palpate.main", "teleop"]
    running, valid = dict[str, subprocess.Popen[bytes]](), {0}
    # A background job of a script ignores SIGINT, and its processes would inherit that.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        for side, options in commands.items():
            with (folder / f"{side}.log").open("wb") as file:
                running[side] = subprocess.Popen([*program, side, *options], stdout=file, stderr=file)  # noqa: S603
        signal.signal(signal.SIGINT, handler)
        until_s = time.monotonic() + _START_S
        while not all((folder / f"{side}.mcap").exists() for side in _SIDES):
            if any(process.poll() is not None for process in running.values()):
                break
            if time.monotonic() > until_s:
                raise PalpateError(f"{_TOO_SLOW}: both sides did not start within {_START_S:g} s. {_AGAIN}")
            time.sleep(_POLL_S)
        with suppress(subprocess.TimeoutExpired):
            running["leader"].wait(_LIMIT_S)
        if running["leader"].poll() is None:  # the machine is slow: use the data recorded so far
            valid.add(INTERRUPTED)
            for process in running.values():
                process.send_signal(signal.SIGINT)
        _wait_for_ends(running, valid, folder)
    finally:
        signal.signal(signal.SIGINT, handler)
        for process in running.values():
            if process.poll() is None:
                process.terminate()
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_END_S)
                process.kill()
    return INTERRUPTED in valid
