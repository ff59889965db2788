"""The HTML report: whole, offline, harmless, and drawn by a real browser."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image

from estimation.diagnosis.search.library import library
from palpate.findings.effect_library import library_with
from palpate.findings.estimation_run import load_material
from palpate.findings.story import diagnose_subjects, tell_story
from palpate.findings.subject import subjects_of
from palpate.report import Report
from palpate.report.outcome import write_outcome
from palpate.report.section import SECTIONS, in_order
from palpate.report.sections.equations import typeset, written_out
from palpate.report.write import document
from tests.palpate.presses import write_presses

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *("--disable-sync", "--hide-scrollbars", "--virtual-time-budget=8000"),
)


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    return load_material(write_presses(tmp_path_factory.mktemp("report") / "<b>hard.csv"))


@pytest.fixture(scope="module")
def story(material):
    (subject,) = subjects_of(material, None, material.arm)
    effects = library_with(None).effects
    (found,) = diagnose_subjects([subject], effects, lambda what, share: None, "x").channels
    return tell_story(subject, found, ["cubic_stiffness"], effects)


@pytest.fixture(scope="module")
def page(material, story, tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    return write_outcome(folder, material, [story], ["palpate add <data> cubic_stiffness"])["report"]


@pytest.mark.parametrize("name", list(SECTIONS))
def test_every_section_has_the_form_and_tells_something(name, story):
    section = SECTIONS[name]()
    assert re.fullmatch(r"[a-z_]+", section.name)
    assert section.title
    told = section.html(Report("file", {}, (story,), ("palpate diagnose file",)))
    assert told or name == "next_experiment"
    assert section.html(Report("file", {}, (), ())) == "" or name == "reproduce"


def test_the_verdict_comes_first_and_places_are_distinct():
    places = [section.place for section in in_order()]
    assert in_order()[0].name == "verdict"
    assert len(set(places)) == len(places)


def test_the_page_brings_everything_and_names_no_other_place(page):
    text = page.read_text()
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert text.count("plotly.js v") == 1
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", own)
    assert "default-src 'none'" in own
    for words in ("cubic_stiffness", "noise floor", "F</i> =", "k<sub>3</sub>", "palpate add &lt;data&gt;"):
        assert words in own


def test_names_from_files_are_only_text(page):
    assert "<b>hard" not in page.read_text()
    assert "&lt;b&gt;hard" in page.read_text()


def test_equations_are_typeset():
    assert typeset("F = k1 x^n + b x^(n+1), tau < 1") == (
        "F = k<sub>1</sub> x<sup>n</sup> + b x<sup>(n+1)</sup>, τ &lt; 1"
    )


def test_every_effect_can_be_written_out(story):
    base = story.stages[0].model
    names = {effect.name for effect in base.effects}
    for effect in library():
        if effect.name not in names:
            line = written_out(base.with_effect(effect))
            assert line.count("<span") == line.count("</span>")
            assert "F</i> = " in line


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (apt install chromium)")
def test_a_browser_without_network_draws_the_plots(page, tmp_path):
    picture = tmp_path / "page.png"
    dumped = browse(page, tmp_path, "--dump-dom")
    assert dumped.count('class="main-svg"') >= 6  # three figures of two layers each
    assert "Error" not in re.sub(r"<script>.*?</script>", "", dumped, flags=re.DOTALL)
    browse(page, tmp_path, "--window-size=1120,2400", f"--screenshot={picture}")
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    assert np.mean((pixels > 245).all(axis=1)) > 0.6  # light and tidy
    measured = np.abs(pixels.astype(int) - (0x2A, 0x6F, 0xB0)).sum(axis=1) < 12
    assert measured.sum() > 500  # the blue of what was measured


def browse(page, folder, *arguments):
    """Open the page with a dead proxy, so that nothing from elsewhere can come in."""
    command = [CHROMIUM, *FLAGS, "--proxy-server=127.0.0.1:9", f"--user-data-dir={folder / 'profile'}"]
    done = subprocess.run(
        [*command, *arguments, page.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout


def test_nothing_is_left_where_it_cannot_be_written(material, story, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(Exception, match=r"report\.html"):
        write_outcome(tmp_path, material, [story], [])
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_a_channel_that_cannot_be_judged_is_told_too(tmp_path):
    one = load_material(write_presses(tmp_path / "one.csv", speeds_m_s=(0.02,)))
    (subject,) = subjects_of(one, None, one.arm)
    (found,) = diagnose_subjects([subject], library(), lambda what, share: None, "x").channels
    told = document(Report("one", {}, (tell_story(subject, found, [], ()),), ()))
    assert "INSUFFICIENT" in told
    assert "single run" in told
