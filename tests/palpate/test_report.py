"""HTML report: complete, offline, escaped, and drawn by a browser in light and dark."""

import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from palpate.common.files import write_text
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.effects.gravity_load import KnownRigidBody
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.model import Model
from palpate.render import palette, report
from palpate.render.build import equation_of, result_view, write_outcome
from palpate.render.report import bold, document, typeset
from palpate.render.view import StudyView
from palpate.robot_io.errors import InputError
from palpate.study import Study
from tests.few_effects import try_few_effects
from tests.palpate.presses import write_presses

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *("--disable-sync", "--hide-scrollbars", "--virtual-time-budget=8000"),
)
DARK = "--blink-settings=preferredColorScheme=0"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    presses = tmp_path_factory.mktemp("report") / "<b>hard.csv"
    return Study(write_presses(presses, speeds_m_s=(0.04, 0.08, 0.06)), keep=False)


@pytest.fixture(scope="module")
def result(study):
    with pytest.MonkeyPatch.context() as patch:
        try_few_effects(patch)
        (found,) = study.diagnose().channels
    return study.result(study.channel(), ["cubic_stiffness"], found)


@pytest.fixture(scope="module")
def page(study, result, tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    return write_outcome(folder, study, [result], ["palpate add <data> cubic_stiffness"])["report"]


def own(text):
    """The page without its scripts, of which the largest is plotly's."""
    return re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)


def test_page_is_self_contained_and_names_no_other_place(page):
    text = page.read_text()
    assert text.count("plotly.js v") == 1
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", own(text))
    assert "default-src 'none'" in text
    for words in ("cubic_stiffness", "noise level", "F =", "k<sub>3</sub>", "palpate add &lt;data&gt;"):
        assert words in own(text)
    assert "<b>hard" not in text  # names from files are only text
    assert "&lt;b&gt;hard" in text


@pytest.mark.parametrize(("low", "high", "cell"), [(-0.34, 0.48, "><"), (0.04, 0.1, ">43 %<")])
def test_parameter_error_is_in_percent_unless_its_interval_contains_zero(result, low, high, cell):
    parameter = ParameterEstimate("damping.c", "N s/m", 0.07, 0.2, (low, high))
    told = own(document(StudyView("f", (replace(result_view(result), parameters=(parameter,)),))))
    assert f'N s/m</td><td class="number"{cell}/td>' in told


def test_page_orders_verdict_error_parameters_failures_and_next_steps(result):
    following = {"purpose": "tell more", "separates": [], "instruction": "press", "probe": {}}
    found = result.diagnosis.model_copy(update={"next_experiment": following})
    view = result_view(replace(result, diagnosis=type(found)(**dict(found))))
    told = own(document(StudyView("f", (view,))))
    titles = ("MISSING", "How the error falls", "Parameters", "Where the model fails", "Next experiment")
    places = [told.index(title) for title in (*titles, "Evidence", "The fitted model")]
    assert places == sorted(places)


def test_page_is_well_formed(page):
    class Balanced(HTMLParser):
        VOID = ("meta", "br", "link", "img", "hr")

        def __init__(self):
            super().__init__()
            self.open = []

        def handle_starttag(self, tag, _attributes):
            if tag not in self.VOID:
                self.open.append(tag)

        def handle_endtag(self, tag):
            assert self.open.pop() == tag

    parser = Balanced()
    parser.feed(own(page.read_text()))
    assert parser.open == []


def test_text_is_bold_escaped_and_typeset():
    assert bold("bias <b> biased, bias", ["bias"]) == "<b>bias</b> &lt;b&gt; biased, <b>bias</b>"
    assert bold("a<i> (or <i>)", ["<i>"]) == "a&lt;i&gt; (or <b>&lt;i&gt;</b>)"
    assert typeset("F = k1 x^n + b x^(n+1), tau < 1\nwith mu") == (
        "F = k<sub>1</sub> x<sup>n</sup> + b x<sup>(n+1)</sup>, τ &lt; 1<br>with μ"
    )
    model = Model("rigid_body", (KnownRigidBody(),))
    assert equation_of(model) == "tau = [M(q) a + C(q, v) v + g(q)]_j\nwith j the joint"


def test_every_effect_can_be_written_out(result):
    base = result.stages[0].fitted.model
    names = {effect.name for effect in base.effects}
    for effect in effect_library():
        if effect.name not in names:
            lines = equation_of(base.with_effect(effect)).splitlines()
            assert lines[0].startswith("F = k x + c v")
            assert all(
                line.startswith(("with ", "on the motion ", "springs fade as ", "seen as "))
                for line in lines[1:]
            )


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (apt install chromium)")
@pytest.mark.parametrize(("look", "is_paper"), [((), lambda p: p > 235), ((DARK,), lambda p: p < 60)])
def test_browser_draws_the_plots_without_network(page, tmp_path, look, is_paper):
    picture = tmp_path / "page.png"
    dumped = browse(page, tmp_path, *look, "--dump-dom")
    assert dumped.count('class="main-svg"') >= 8  # four figures of two layers each
    assert "Error" not in re.sub(r"<script.*?</script>", "", dumped, flags=re.DOTALL)
    browse(page, tmp_path, *look, "--window-size=1120,2400", f"--screenshot={picture}")
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    assert np.mean(is_paper(pixels).all(axis=1)) > 0.6  # tidy
    measured = np.abs(pixels.astype(int) - (0x3F, 0x86, 0xC8)).sum(axis=1) < 12
    assert measured.sum() > 500  # the blue of what was measured


def browse(page, folder, *arguments):
    """Open the page with a dead proxy, so that nothing from elsewhere can come in."""
    command = [CHROMIUM, *FLAGS, "--proxy-server=127.0.0.1:9", f"--user-data-dir={folder / 'profile'}"]
    done = subprocess.run(
        [*command, *arguments, page.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout


def test_unwritable_folder_stays_empty(result, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html"):
        write_text(tmp_path / "report.html", document(StudyView("f", (result_view(result),))))
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_channel_without_diagnosis_is_reported(tmp_path):
    press = write_presses(tmp_path / "one.csv", speeds_m_s=(0.02,))
    press.write_text("\n".join(press.read_text().splitlines()[:51]) + "\n")
    one = Study(press, keep=False)
    (found,) = one.diagnose().channels
    told = document(StudyView("one", (result_view(one.result(one.channel(), (), found)),)))
    assert "INSUFFICIENT" in told
    assert "only 50 samples" in told


class TestFigures:
    """What is drawn is what the view holds."""

    def test_bars_are_the_errors_and_curves_the_measured_first_and_last_model(self, result):
        view = result_view(result)
        shown = report.error_steps_figure(view)
        np.testing.assert_allclose(shown.data[0].x, [stage.rmse for stage in result.stages])
        assert shown.layout.shapes[0].x0 == view.noise_level
        # the labels right of the bars need no share of a narrow window's width
        assert shown.layout.margin.r > 6.0 * max(map(len, shown.data[1].text))
        shown = report.time_figure(result_view(result))
        names = ["measured", *("kelvin_voigt", "kelvin_voigt + cubic_stiffness") * 2]
        assert [trace.name for trace in shown.data] == names
        assert np.nanmax(shown.data[0].y) == pytest.approx(result.channel.data.effort.max(), rel=1e-6)
        assert shown.layout.yaxis.title.text == "contact force [N]"

    def test_excluded_samples_are_shaded_without_residual(self, result):
        view = result_view(result)
        shown = report.time_figure(replace(view, scored=view.time_s > 0.3 * view.time_s[-1]))
        shades = [shape for shape in shown.layout.shapes if shape.type == "rect"]
        assert min(shade.x0 for shade in shades) == view.time_s[0]
        assert max(shade.x1 for shade in shades) == pytest.approx(0.3 * view.time_s[-1], rel=0.02)
        left = shown.data[-1]
        assert left.x[np.isfinite(left.y)].min() >= 0.3 * view.time_s[-1] - 1e-4

    def test_measured_curves_over_the_state_are_colored_by_speed(self, result):
        view = result_view(result)
        words = list(dict.fromkeys(view.speeds.values()))
        traces = [trace for trace in report.state_figure(view).data if trace.name.startswith("measured, ")]
        assert [trace.name for trace in traces[: len(words)]] == [f"measured, {word}" for word in words]
        assert len({trace.line.color for trace in traces}) == len(words) > 1
        every = report.state_figure(view).data
        for trace in traces[: len(words)]:  # each press has one color, and its models are dashed
            models = [m for m in every if m.line.color == trace.line.color and m.xaxis == trace.xaxis]
            assert [model.line.dash for model in models] == ["solid", "1px,2px", "4px,2px"]
        grays = [trace for trace in every if trace.line.color == palette.BASE and trace.showlegend]
        assert [trace.name for trace in grays] == [stage.name for stage in view.stages]
        assert all(np.isnan(trace.y).all() for trace in grays)

    def test_force_over_displacement_shows_each_model_by_its_whole_name(self, study):
        grown = study.result(study.channel(), ["bias", "cubic_stiffness"])
        traces = [one for one in report.state_figure(result_view(grown)).data if one.xaxis == "x"]
        shown = {one.name: one.visible for one in traces if not one.name.startswith("measured")}
        names = ["kelvin_voigt", "kelvin_voigt + bias"]
        names.append(f"{names[1]} + cubic_stiffness")
        assert shown == dict(zip(names, (True, "legendonly", True), strict=True))
        assert "Contact force over depth" in document(StudyView("f", (result_view(grown),)))

    def test_both_maps_share_one_scale_and_a_notebook_gets_one_figure(self, result):
        first, last = report.map_figure(result_view(result)).data
        assert (first.zmin, first.zmax) == (last.zmin, last.zmax)
        assert np.nanstd(last.z) < 0.5 * np.nanstd(first.z)
        shown = report.figure(result_view(result))
        assert {trace.type for trace in shown.data} == {"bar", "scatter"}
        colors = {(trace.name, trace.line.color) for trace in shown.data if trace.type == "scatter"}
        assert len(colors) == 3  # measured and two models, in every plot alike
        titles = [note.text for note in shown.layout.annotations]
        assert {"Error in held-out runs", "Over position", "Over time"} <= set(titles)
