"""Measure the workbench page in Chromium: time from tick to new curves, start time, memory, many ticks.

    python benchmarks/workbench.py [--session FILE] [--ticks 1000] [--chromium PATH]

Without --session, a simulated arm with three joints first probes for a minute at 1 kHz. A tick ends when the
error in held-out runs and the curves have changed in the browser, at its next frame. The effects are ticked
at once; after a few seconds of looking, the page would have fitted some ahead.
"""

import os
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import psutil  # type: ignore[import-untyped]
from harness import PALPATE, arguments, resident_mb, run_palpate
from playwright.sync_api import Page, sync_playwright

from palpate.robot_io.types import FloatArray

MOST_S = 120.0
MINUTE = ("--hidden", "cubic_stiffness", "--seed", 3, "--repeats", 9)  # of a press with a hidden effect
EFFECTS = ("cubic_stiffness", "stress_relaxation", "plastic_set", "adhesion", "drift", "quadratic_damping")
_TICK, _RAW = (
    Path(__file__).with_name(f"workbench_{name}.js").read_text("utf-8") for name in ("tick", "raw")
)


@contextmanager
def served(command: Sequence[str], port: int, folder: Path) -> Iterator[psutil.Process]:
    """Run a server on this machine until the context ends."""
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    try:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            time.sleep(0.02)
        yield psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait()


def ticks(page: Page, effects: Sequence[str], pause_s: float = 0.0) -> FloatArray:
    """Return the times from ticks to new curves, and to those of the fit, shape (ticks, 2) [ms]."""
    durations = []
    for effect in effects:
        durations.append(page.evaluate(_TICK, effect))
        time.sleep(pause_s)
    return np.array(durations)


def print_times(what: str, times_ms: FloatArray) -> None:
    """Print median and 95th percentile of ticks (ticks, 2), for the preview and for the fit."""
    for label, column in zip(("new curves", "the fit"), times_ms.T, strict=True):
        median, high = np.median(column), np.quantile(column, 0.95)
        print(f"{what}, {label}: median {median:.0f} ms, p95 {high:.0f} ms ({len(column)} ticks)", flush=True)


def measure_workbench(page: Page, session: Path, folder: Path, count: int) -> None:
    """Measure the page of palpate."""
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.add_init_script(_RAW)
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        port = int(tried.getsockname()[1])
    begun = time.time()
    options = [str(session), "--port", str(port), "--no-browser"]
    with served([*PALPATE, "workbench", *options], port, folder) as process:
        page.goto(f"http://127.0.0.1:{port}", wait_until="commit")
        page.wait_for_selector(".scatterlayer .js-line")
        curves_s = time.time() - begun
        page.wait_for_selector("[data-error]")
        error_s = time.time() - begun
        raw_s = next(float(text[4:]) for text in said if text.startswith("raw ")) / 1e3 - begun
        shown = f"raw curves {raw_s:.1f} s, to zoom in {curves_s:.1f} s, error {error_s:.1f} s"
        print(f"after the command: {shown}")
        page.wait_for_selector('[data-effect="cubic_stiffness"] .q-checkbox')
        print_times("at once, hardly anything fitted ahead", ticks(page, np.repeat(EFFECTS, 2).tolist(), 0.3))
        ticks(page, EFFECTS[:1] * 20)
        page.wait_for_timeout(3000)
        before = resident_mb(process)
        print_times("many", ticks(page, EFFECTS[:1] * count))
        page.wait_for_timeout(3000)
        after = resident_mb(process)
        print(f"memory of all processes: {before:.0f} MB, after {count} ticks {after / before - 1:+.1%}")


def main() -> None:
    """Run the measurements."""
    parser = arguments(__doc__)
    parser.add_argument("--session", type=Path)
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    chosen = parser.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        if chosen.session is None:
            run_palpate("probe", *MINUTE, "--out", folder / "minute.mcap")
        session = chosen.session.resolve() if chosen.session else folder / "minute.mcap"
        browser = playwright.chromium.launch(executable_path=chosen.chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(1000 * MOST_S)
        measure_workbench(page, session, folder, chosen.ticks)
        browser.close()
    print(f"load of the machine after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
