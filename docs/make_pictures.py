"""Makes the pictures of the docs from real runs: `.venv/bin/python docs/make_pictures.py [DATA_DIR]`.

Everything is probed, estimated and drawn anew, with the same code that the commands use. The picture of
measured data needs the folder with the measurements; without it that one is left as it is.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from estimation.data.import_file import import_file
from estimation.data.import_options import ImportOptions
from estimation.study.estimates import BEST, estimate_with
from palpate.demo.hidden import STRENGTH, probe_hidden, solve
from palpate.demo.probe import Demo, probe_demo, show_demo
from palpate.views.plots import save_plots
from palpate.views.viewer import take_picture
from sim_backend.hidden import noise_scale
from sim_backend.imperfection import IMPERFECTIONS
from sim_backend.noise_scale import CONTACT
from sim_backend.scenario import load_scenario

PICTURES = Path(__file__).parent / "pictures"
SCREEN = (1600, 1000)
MOMENT_S = 4.6  # the second run is holding its force
SOFT = Path("soft_indentation") / "runs.csv.gz"


def main(data_dir: Path | None) -> None:
    """Make them all."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        draw_simulated(Path(folder))
        draw_hidden(Path(folder))
    if data_dir is not None:
        draw_measured(data_dir / SOFT)


def draw_simulated(folder: Path) -> None:
    """The default object as the demo shows it, and the paper's (its figure 4a)."""
    demo = probed(folder / "demo.mcap", "default")
    for plot in demo.plots:
        shutil.copyfile(plot, PICTURES / plot.name)
    take_picture(demo.recording, PICTURES / "rerun.png", MOMENT_S, SCREEN)
    paper = probed(folder / "paper.mcap", "paper")
    figure_4a = next(plot for plot in paper.plots if plot.stem == "force-displacement")
    shutil.copyfile(figure_4a, PICTURES / "force-displacement-paper.png")


def draw_hidden(folder: Path) -> None:
    """Something is hidden in the default object, found and added: the picture, and the model growing."""
    session = folder / "hidden.mcap"
    effect = IMPERFECTIONS["stress_relaxation"]
    world = load_scenario("default")
    rng = np.random.default_rng(1)
    hidden = effect.at_strength(STRENGTH, CONTACT, noise_scale(world), rng)
    probe_hidden(session, world.with_hidden([hidden]), seed=1)
    demo = solve(session, lambda what, share: None)
    take_picture(demo.files["recording"], PICTURES / "revisions.png", 0.0, SCREEN, revision=1)
    browser = shutil.which("chromium")
    if browser is not None:
        shoot(browser, demo.files["report"], PICTURES / "report.png", folder / "profile")


def shoot(browser: str, page: Path, picture: Path, profile: Path) -> None:
    """The upper part of a report as a browser shows it."""
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync")
    quiet = ("--disable-background-networking", "--hide-scrollbars", "--virtual-time-budget=8000")
    size = (f"--user-data-dir={profile}", "--window-size=1120,1500", f"--screenshot={picture}")
    subprocess.run([browser, *flags, *quiet, *size, page.as_uri()], check=True, capture_output=True)  # noqa: S603, our own page


def probed(session: Path, scenario: str) -> Demo:
    """One object, as `palpate demo` probes and shows it."""
    probe_demo(session, load_scenario(scenario), seed=1)
    return show_demo(session)


def draw_measured(file: Path) -> None:
    """A soft specimen under an indenter, with the simple model that does not describe it."""
    options = ImportOptions(where={"source_file": "230515_hold"})
    channel = import_file(file, options).channels[0]
    found = estimate_with(channel, "kelvin_voigt", BEST)
    with tempfile.TemporaryDirectory() as folder:
        save_plots(None, found, Path(folder))
        shutil.copyfile(Path(folder) / "force-displacement.png", PICTURES / "soft-indentation.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
