"""Makes the pictures of the docs from real runs: `.venv/bin/python docs/make_pictures.py [DATA_DIR]`.

Everything is probed, estimated and drawn anew, with the same code that the commands use. Needs Chromium and a
Vulkan driver (apt install chromium mesa-vulkan-drivers). The picture of measured data needs the folder with
the measurements; without it that one is left as it is.
"""

import shutil
import subprocess
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from palpate.commands.demo import HIDDEN_PLAN, hide_one, probe_demo, show_demo, solve
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.estimates import PREFERRED, estimate_with
from palpate.render.estimates import estimates_view
from palpate.render.recording.file import capture_screenshot
from palpate.render.report import state_figure
from palpate.sim_backend.scenario import load_scenario
from palpate.study import Study

PICTURES = Path(__file__).parent / "pictures"
SCREEN = (1600, 1000)
MOMENT_S = 4.6  # the second run is holding its force
SOFT = Path("soft_indentation") / "runs.csv.gz"
SHARP = 2  # pixels of a picture for each of the figure


def main(data_dir: Path | None) -> None:
    """Make them all."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        draw_simulated(Path(folder))
        draw_hidden(Path(folder))
        draw_lessons(Path(folder))
        if data_dir is not None:
            draw_measured(data_dir / SOFT, Path(folder))


def draw_simulated(folder: Path) -> None:
    """The default object as the demo shows it."""
    session = folder / "demo.mcap"
    probe_demo(session, load_scenario("default"), seed=1)
    capture_screenshot(show_demo(session)[2], PICTURES / "rerun.png", MOMENT_S, SCREEN)


def draw_hidden(folder: Path) -> None:
    """Something is hidden in the default object, found and added: the picture, and the model growing."""
    session = folder / "hidden.mcap"
    world = hide_one(load_scenario("default"), np.random.default_rng(1), ("stress_relaxation",))
    probe_demo(session, world, seed=1, plan=HIDDEN_PLAN)
    demo = solve(session, lambda what, share: None)
    capture_screenshot(demo.files["recording"], PICTURES / "revisions.png", 0.0, SCREEN, revision=1)
    shoot(demo.files["report"], (1120, 1500), PICTURES / "report.png", folder)


def draw_lessons(folder: Path) -> None:
    """The data of two lessons, and the model before and after the missing effect is added."""
    with chdir(folder):
        page = (Path(__file__).parent / "tutorial" / "your-own-file.md").read_text(encoding="utf-8")
        exec(page.split("```python\n")[1].split("```")[0], {})  # noqa: S102, the page's own code
        probe = ("palpate", "probe", "--hidden", "random", "--seed", "7", "-o", "riddle.mcap")
        subprocess.run(probe, check=True)  # noqa: S603, our own command
        for file, effect in (("press.csv", "stress_relaxation"), ("riddle.mcap", "layered_stiffness")):
            study = Study(file, keep=False)
            study.add(effect, channel="contact")
            figure = study.plot("contact").update_layout(height=720)
            draw(figure, 1200, PICTURES / f"{Path(file).stem}.png", folder)


def draw_measured(file: Path, folder: Path) -> None:
    """A soft specimen under an indenter, with the simple model that does not describe it."""
    channel = import_file(file, ImportOptions(where={"source_file": "230515_hold"})).channels[0]
    found = estimate_with(channel, "kelvin_voigt", PREFERRED)
    draw(state_figure(estimates_view(found, {})), 900, PICTURES / "soft-indentation.png", folder)


def draw(figure: go.Figure, width: int, picture: Path, folder: Path) -> None:
    """A figure as PNG."""
    figure.update_layout(width=width, paper_bgcolor="white", plot_bgcolor="white")
    # At two pixels for one, Chromium cuts the last letter of a legend entry unless blanks follow it.
    figure.for_each_trace(lambda trace: trace.update(name=f"{trace.name}   ") if trace.showlegend else None)
    page = folder / f"{picture.stem}.html"
    html = figure.to_html(config={"displayModeBar": False})
    page.write_text(html.replace("<body>", '<body style="margin:8px; background:white">'), encoding="utf-8")
    shoot(page, (width + 16, figure.layout.height + 16), picture, folder, scale=SHARP)


def shoot(page: Path, size: tuple[int, int], picture: Path, folder: Path, scale: int = 1) -> None:
    """The upper part of a page as a browser shows it."""
    browser = shutil.which("chromium")
    if browser is None:
        sys.exit("no Chromium here: apt install chromium")
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync")
    quiet = ("--disable-background-networking", "--hide-scrollbars", "--virtual-time-budget=8000")
    look = (f"--window-size={size[0]},{size[1]}", f"--force-device-scale-factor={scale}")
    where = (f"--user-data-dir={folder / 'profile'}", f"--screenshot={picture}", page.as_uri())
    subprocess.run([browser, *flags, *quiet, *look, *where], check=True, capture_output=True)  # noqa: S603, our own page


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
