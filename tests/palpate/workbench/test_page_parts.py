"""Parts of the page by themselves: numbers, drawings, the live view, dropped files, and a diagnosis."""

import asyncio
import os
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from nicegui import ui

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.measurement_noise import MeasurementNoise, NoiseSource
from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.render import palette
from palpate.robot_io.errors import InputError, PalpateError
from palpate.study import Study
from palpate.workbench import diagnosis as diagnosis_module
from palpate.workbench import elements, file_drop, layout, live, processes, startup
from palpate.workbench.diagnosis import DiagnosisCard, riddle_card
from palpate.workbench.elements import Plot
from palpate.workbench.file_drop import FileDrop
from palpate.workbench.parameters import ErrorCard, Parameters, waterfall
from palpate.workbench.plots import DrawnMotion, map_figure, state_figure, time_figure
from palpate.workbench.processes import DiagnosisProcess, StoppedError
from palpate.workbench.startup import AppState, raw_curves, thumbnail_svg
from palpate.workbench.state import ModelSelection
from tests.palpate.presses import write_presses
from tests.palpate.test_budget import RELAXATION, SHAPE, diagnosis
from tests.palpate.workbench.test_foxglove import pressing
from tests.palpate.workbench.test_interaction import Browser

__all__ = ["browser"]


@pytest.fixture
def browser(monkeypatch):
    return Browser(monkeypatch)


def noise_of(value, *, is_bound=False):
    return MeasurementNoise(value, NoiseSource.FREE_AIR, None if is_bound else value, 0.0)


def test_waterfall_has_a_bar_for_each_stage_and_a_line_at_the_noise():
    stages = (("a<b", 2.0), ("+ lag", 0.5), ("+ bias", 0.4985), ("+ drift", 1.0))
    html = waterfall(stages, noise_of(0.1), "N")
    assert re.findall(r"width:([\d.]+)%", html) == ["100.0", "25.0", "24.9", "50.0"]
    assert re.findall(r"left:([\d.]+)%", html) == ["5.0"] * 4
    assert re.findall(r"<em>(.*?)</em>", html) == ["", " −75 %", "", ""]  # no fall below 0.5 %
    assert re.findall(r'<i class="(.*?)"', html) == ["base", "", "", ""]
    assert "a&lt;b" in html
    assert "noise 0.100 N, from free air" in html
    bound = waterfall((("a", 0.0),), noise_of(9.0, is_bound=True), "N")
    assert 'left:100.0%"' in bound
    assert "noise at most 9.00 N, from free air" in bound


@pytest.mark.parametrize(
    ("rmse", "least", "noise", "unphysical", "beside", "fits"),
    [
        (1.0, 0.99, 1.0, (), "at the noise level", True),
        (1.0, 0.99, 1.0, ("damping.c would be below 0",), "at the noise level", False),
        (1.0, 0.5, 0.99, (), "a flexible regression reaches 0.500 N", False),
        (1.0, 0.5, 0.4, (), "2.5 × noise level", False),
        (1.0, 1.0, 0.0, (), "inf × noise level", False),
    ],
)  # fmt: skip
def test_error_fits_if_neither_noise_nor_a_flexible_regression_is_below(
    rmse, least, noise, unphysical, beside, fits
):
    card, shown = ErrorCard(), {}
    for name in ("number", "fall"):
        setattr(
            card, f"_{name}", SimpleNamespace(set_content=lambda html, name=name: shown.update({name: html}))
        )
    card._wrong = SimpleNamespace(set_text=lambda text: shown.update(wrong=text))
    data = SimpleNamespace(kind=ChannelKind.CONTACT, effort_unit="N")
    fitted = SimpleNamespace(data=data, rmse=rmse, smooth_law_error=least, unphysical=unphysical)
    of = SimpleNamespace(
        fitted=fitted, noise=noise_of(noise), steps=(("a", 1.0),), is_rough=False, is_incomplete=False
    )
    card.show(of)
    assert 'class="fits"' not in shown["number"]
    card.judge(of)
    assert f">{beside}</span>" in shown["number"]
    assert ('class="fits"' in shown["number"]) is fits
    assert shown["wrong"].startswith("damping.c would be below 0") is bool(unphysical)
    judged = dict(shown)
    card.preview(of, 3.0)
    assert shown["wrong"] == ""
    assert "moved sliders" in shown["fall"]
    assert '<span class="value">3.00 N<em>' in shown["fall"]
    card.show(of)  # known already
    assert shown == judged
    of.noise = noise_of(noise, is_bound=True)
    for of.is_incomplete, words in ((False, "may be noise"), (True, "≥ 1.0 × noise level")):
        card.judge(of)
        if beside == "at the noise level":  # the error is not called noise if the diagnosis says otherwise
            assert f">{words}</span>" in shown["number"]
            assert ('class="fits"' in shown["number"]) is (fits and not of.is_incomplete)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    six = write_presses(
        tmp_path_factory.mktemp("p") / "press.csv", speeds_m_s=(0.02, 0.04, 0.08, 0.03, 0.05, 0.06)
    )
    return Study(six, keep=False).channels[0].data


def test_model_is_drawn_over_position_and_velocity_and_the_residual_on_the_base_model_s_axis(data):
    motion, left = DrawnMotion.of(data), np.linspace(-2.0, 1.0, len(data))
    axis = time_figure(motion, (data.effort - left, left), None)["layout"]["yaxis2"]
    assert axis["range"] == pytest.approx([-2.3, 2.3])
    figure = state_figure(motion, 2.0 * data.effort)
    traces = figure["data"]
    assert [trace["name"] for trace in traces] == ["measured", "model"] * 2
    assert not any(trace["showlegend"] for trace in traces)
    for trace, values in zip(traces[::2], (1e3 * data.position, 1e3 * data.velocity), strict=True):
        x = trace["x"][np.isfinite(trace["x"])]
        assert np.isin(x, values.astype(np.float32)).all()
        assert 450 < len(x) < 2 * 900
    assert traces[0]["x"][np.isfinite(traces[0]["x"])].min() > -0.1 * 1e3 * data.position.max()
    np.testing.assert_allclose(traces[3]["y"], 2.0 * traces[2]["y"])
    assert np.isnan(state_figure(motion, None)["data"][1]["y"]).all()
    assert np.isnan(traces[0]["x"]).sum() == 4 - 1  # gaps between four of the six runs
    one = state_figure(DrawnMotion.of(data, (2,)), None)["data"][0]["x"]
    assert not np.isnan(one).any()


def test_strain_is_drawn_in_the_unit_of_its_axis(data):
    motion = DrawnMotion.of(replace(data, proxy_units={"position": "strain"}))
    assert motion.axes.position == "depth [strain]"
    np.testing.assert_array_equal(motion.position, data.position)


def panels(figure, narrow=False):
    """Left, right, bottom and top of each panel of a figure, as shares of its area."""
    changes, found = figure["narrow"] if narrow else {}, set()
    for trace in figure["data"]:
        names = (f"{letter}axis{trace.get(f'{letter}axis', letter)[1:]}" for letter in "xy")
        x, y = (figure["layout"][name] | changes.get(name, {}) for name in names)
        if "overlaying" not in y:
            found.add((*x.get("domain", (0.0, 1.0)), *y.get("domain", (0.0, 1.0))))
    return sorted(found)


def test_panels_of_a_figure_lie_beside_each_other(data):
    motion = DrawnMotion.of(data)
    state, maps = (
        make(motion, *efforts)
        for make, efforts in ((state_figure, [data.effort]), (map_figure, 2 * [data.effort]))
    )
    drawn = [panels(state), panels(state, narrow=True), panels(maps), panels(maps, narrow=True)]
    drawn += [panels(time_figure(motion, None, None)), panels(live.live_figure(pressing(9)))]
    assert [len(each) for each in drawn] == [2, 2, 2, 2, 2, 3]
    for each in drawn:
        for number, (left, right, bottom, top) in enumerate(each):
            assert 0.0 <= left < right <= 1.0
            assert 0.0 <= bottom < top <= 1.0
            for others in each[:number]:
                assert left > others[1] or bottom > others[3] or top < others[2]
    assert state["narrow"]["height"] > state["layout"]["height"]


def test_residuals_of_both_models_share_a_color_scale(data):
    motion = DrawnMotion.of(data)
    assert time_figure(motion, None, None)["layout"]["yaxis2"]["range"] == [-1.0, 1.0]  # no model yet
    before = np.where(data.position > 0.005, 1.0, -0.5)
    figure = map_figure(motion, before, 0.1 * before)
    base, model = figure["data"]
    assert {-base["zmin"], base["zmax"], -model["zmin"], model["zmax"]} == {1.0}
    assert (np.nanmin(base["z"]), np.nanmax(base["z"])) == pytest.approx((-0.5, 1.0))
    np.testing.assert_allclose(model["z"], 0.1 * base["z"], rtol=1e-6)
    assert np.nanmin(np.where(np.isfinite(base["z"]), base["x"], np.nan)) > 0.0  # only in contact
    assert [trace["showscale"] for trace in (base, model)] == [False, True]
    unknown = map_figure(motion, np.full(len(data), np.nan), before)["data"]
    assert unknown[0]["zmax"] == 1.0


def test_plot_sends_what_it_was_told_once_the_browser_is_ready(browser):
    async def work():
        plot, sent = Plot({"data": [{"y": [1]}, {"y": [2]}], "layout": {}}), []
        plot.run_method = lambda *message: sent.append(message)
        plot.restyle(({"y": [[5]]}, [1]))
        plot.relayout({"shapes": [3]})
        assert sent == []
        await browser.send(plot, "ready")
        assert sent == [("replace", {"data": [{"y": [1]}, {"y": [5]}], "layout": {"shapes": [3]}})]
        plot.restyle(({"y": [[6], [7]]}, [1, 0]))
        plot.replace({"data": []})
        assert [message[0] for message in sent[1:]] == ["restyle", "replace"]
        assert plot.figure == {"data": []}

    browser.use(work)


def test_model_without_parameters_says_so(browser):
    async def work():
        card = Parameters(None, None, None)
        card.build()
        card.show(SimpleNamespace(fitted=None, values={}, choice=ModelSelection("joint_1")))
        assert "nothing is fitted in this model" in browser.texts()
        assert not card._back.visible

    browser.use(work)


def test_thumbnail_fills_its_area():
    x, rising, level = np.array([1.0, 2.0, 3.0]), np.array([0.0, 5.0, 10.0]), np.full(3, 5.0)
    svg = thumbnail_svg(x, [(rising, "red"), (level, "blue")], 104, 54)
    drawn = ["2.0,52.0 52.0,27.0 102.0,2.0", "2.0,27.0 52.0,27.0 102.0,27.0"]
    assert re.findall(r'points="([^"]*)"', svg) == drawn
    assert re.findall('stroke="(.*?)"', svg) == ["red", "blue"]
    flat = thumbnail_svg(np.zeros(2), [(np.ones(2), "red")], 104, 54)
    assert '"2.0,52.0 2.0,52.0"' in flat


def test_raw_curves_are_drawn_while_a_session_is_read(monkeypatch, tmp_path):
    ticks = pressing(1000)
    session = SimpleNamespace(stream_names=["tick"], samples=lambda name: ticks)
    monkeypatch.setattr(startup.Session, "open", lambda path: session)
    html = raw_curves(tmp_path / "a.mcap")
    assert re.findall("<h2>(.*?)</h2>", html) == [
        "force [N] from 0.6 to 0.6, over 1.0 s, as measured",
        "joint torques [N m] from -0.5 to 1.5, over 1.0 s, as measured",
    ]
    assert re.findall('stroke="(.*?)"', html) == [palette.MEASURED, *palette.JOINTS[:2]]
    assert raw_curves(tmp_path / "a.csv") == ""
    session.stream_names = ["other"]
    assert raw_curves(tmp_path / "a.mcap") == ""
    session.stream_names, ticks = ["tick"], pressing(0)
    assert raw_curves(tmp_path / "a.mcap") == ""
    unknown = np.full(9, np.nan)
    assert startup._panel("force", np.arange(9.0), [(unknown, "red")]) == ""


def test_data_are_read_in_another_thread_and_a_failure_is_kept(tmp_path):
    home, threads = AppState(tmp_path, raw="<svg>"), []
    home.read(lambda: threads.append(home.waiting) or "state", "a<b.csv")
    while home.reading:
        pass
    assert (home.state, home.error, threads) == ("state", "", ['<p class="quiet">a&lt;b.csv …</p><svg>'])

    def fail():
        raise InputError("no columns")

    home.read(fail, "b.csv")
    while home.reading:
        pass
    assert home.error == "no columns"
    assert home.waiting.startswith('<p class="quiet">opening …')
    first, second = home.serve_report(tmp_path), home.serve_report(tmp_path / "b")
    assert home.reports[second.removeprefix("/report/")] == tmp_path / "b"
    assert len(first) > 25
    assert first != second


def test_live_view_shows_the_last_seconds_until_the_session_is_complete(browser, monkeypatch, tmp_path):
    ticks, timers, done, sent = pressing(20_000), browser.timers, [], []

    class Tail:
        count, complete = 0, False

        def __init__(self, session, stream, last):
            pass

        def read(self):
            if isinstance(self.now, Exception):
                raise self.now
            self.count += len(self.now)
            return self.now

    async def finish(session):
        done.append(session)

    monkeypatch.setattr(live, "SessionTail", Tail)
    session = tmp_path / "live.mcap"
    feed = SimpleNamespace(send=lambda *what: sent.append(what))

    async def work():
        live.live_view(session, finish, feed)
        (plot,), label = browser.all(Plot), browser.marked("live")
        await timers[0].work()  # there is no file yet
        assert (label.text, sent) == ("waiting for the first chunk", [])
        session.touch()
        Tail.now = ticks
        await timers[0].work()
        assert label.text == "20.0 s, run 1, 20000 ticks"
        assert sent == [(session, ticks)]
        force, residual, one, two, k, c = plot.figure["data"]
        assert [trace["name"] for trace in (one, two)] == ["torque 1 [N m]", "torque 2 [N m]"]
        for trace, value in ((force, 0.6), (residual, 0.1), (one, 1.5), (two, -0.5), (k, 500.0), (c, 0.0)):
            np.testing.assert_allclose(trace["y"], value, rtol=1e-5)
            assert trace["x"][0] == pytest.approx(8.0, abs=0.01)  # 12 s
            assert trace["x"][-1] == pytest.approx(19.999)
            assert len(trace["x"]) <= 610
        assert [trace["yaxis"] for trace in (force, one, k, c)] == ["y", "y2", "y3", "y4"]
        Tail.now = pressing(0)
        before = plot.figure
        await timers[0].work()
        assert plot.figure is before
        Tail.complete = True
        await timers[0].work()
        assert (done, timers[0].active) == ([session], False)
        Tail.now = PalpateError("cut off")
        live.live_view(session, finish)
        await timers[-1].work()
        assert "cut off" in browser.texts()
        assert (len(done), timers[-1].active) == (1, False)

    browser.use(work)
    assert live.live_figure(pressing(0))["data"][0]["y"].size == 0


def test_online_residual_is_the_force_that_the_estimates_leave():
    known = {"force_n": 2.0, "stiffness_n_m": 500.0, "damping_n_s_m": 4.0, "surface_m": 0.0002}
    columns = {name: np.full(4, value) for name, value in known.items()}
    columns["tip_position_world_m"] = np.array([[0, 0, -z] for z in (0.001, 0.001, 0.0002, 0.001)])
    columns["tip_velocity_world_m_s"] = np.array([[0, 0, -v] for v in (0.0, 0.1, 0.1, -0.9)])
    columns["press_direction_world"] = np.array([[0.0, 0.0, -1.0]] * 4)
    np.testing.assert_allclose(live.online_residual(columns), [1.6, 1.2, 2.0, 2.0])  # at the surface; no pull


@pytest.mark.parametrize(("truncated", "expected"), [(True, "new.mcap"), (False, None), (None, None)])
def test_newest_session_is_followed_while_it_grows(monkeypatch, tmp_path, truncated, expected):
    assert live.newest_growing(tmp_path) is None
    for name, age_s in (("new.mcap", 100.0), ("a.mcap", 50.0)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (age_s, age_s))

    def opened(path):
        if truncated is None:
            raise PalpateError("no session")
        return SimpleNamespace(truncated=truncated if path.name == "new.mcap" else not truncated)

    monkeypatch.setattr(live.Session, "open", opened)
    found = live.newest_growing(tmp_path)
    assert (found and found.name) == expected


class Upload:
    """A file that a browser sends."""

    def __init__(self, name, content, size=None):
        self.file, self.name, self.content, self._size = self, name, content, size

    def size(self):
        return self._size or len(self.content)

    async def read(self):
        return self.content


def test_dropped_file_is_kept_once_and_its_columns_can_be_corrected(browser, monkeypatch, tmp_path):
    monkeypatch.setattr(file_drop, "DROPPED", tmp_path / "kept")
    opened, refused, emptied = [], [], []

    async def open_file(path, options):
        if refused:
            raise InputError(refused.pop())
        opened.append((path.name, dict(options.columns), dict(options.units)))

    text = b"Time [s],Crosshead [mm],Load\n" + b"".join(b"%f,%d,%d\n" % (n / 10, n, n) for n in range(9))

    async def work():
        drop = FileDrop(open_file)
        (upload,) = browser.all(ui.upload)
        monkeypatch.setattr(upload, "reset", lambda: emptied.append(True))

        async def send(name, content, size=None):
            for handler in upload._upload_handlers:
                await handler(Upload(name, content, size))
            return browser.marked("problem").text

        await send("../press.csv", text)
        await send("press.csv", text)  # the same again
        assert [path.name for path in (tmp_path / "kept").iterdir()] == ["press.csv"]
        await send("press.csv", text + b"1.0,9,9\n")
        assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["press-2.csv", "press.csv"]
        assert "no line of column names" in await send("bad.csv", b"a,b\nx,y\n")
        assert "big.csv: larger than 500 MB" in await send("big.csv", b"", size=500_000_001)
        assert r"'a\x00b.csv': cannot be saved in" in await send("a\0b.csv", b"")
        assert len(emptied) == 6  # the area takes one file after another
        assert not (tmp_path / "kept" / "bad.csv").exists()
        quantity, unit = (
            browser.all(ui.select, aria_label=f"{what} of Load")[0] for what in ("quantity", "unit")
        )
        assert (quantity.value, unit.value, unit.props["label"]) == ("force", None, "unit?")
        unit.value = "mN"
        crosshead = browser.all(ui.select, aria_label="quantity of Crosshead [mm]")[0]
        assert browser.all(ui.select, aria_label="unit of Crosshead [mm]")[0].value == "mm"
        crosshead.value = file_drop.NOTHING
        await browser.press("Use these columns")
        assert opened.pop() == (
            "press-2.csv",
            {"time": "Time [s]", "force": "Load"},
            {"Time [s]": "s", "Load": "mN"},
        )
        assert browser.marked("problem").text == ""
        crosshead.value = "force"
        await browser.press("Use these columns")
        assert "several columns are assigned to force" in browser.marked("problem").text
        crosshead.value, refused[:] = file_drop.NOTHING, ["Load: add --unit force=N"]
        await browser.press("Use these columns")
        assert browser.marked("problem").text.startswith("Load: add --unit force=N (on this page, choose")
        assert await drop.begin(tmp_path)
        assert opened == [(tmp_path.name, {}, {})]

    browser.use(work)


class Worker:
    """Stands for a process and this side's end of its pipe."""

    def __init__(self, *messages):
        self.messages, self.ended = list(messages), []

    def poll(self, wait_s):
        return bool(self.messages)

    def recv(self):
        if isinstance(message := self.messages.pop(0), EOFError):
            raise message
        return message

    def terminate(self):
        self.ended.append("terminated")

    def join(self):
        self.ended.append("joined")

    def close(self):
        self.ended.append("closed")


@pytest.mark.parametrize(
    ("last", "error", "words"),
    [
        (processes.Diagnosis(file="a.csv", model="kelvin_voigt", channels=()), None, ""),
        (InputError("no contact"), InputError, "no contact"),
        (EOFError(), PalpateError, "lack of memory"),
        (None, StoppedError, "nothing was changed"),
    ],
)
def test_diagnosis_process_forwards_progress_result_and_end(monkeypatch, last, error, words):
    worker, process, noted = Worker(("search", 0.5), *([last] if last else [])), DiagnosisProcess(), []
    monkeypatch.setattr(processes, "start_worker", lambda *_: (worker, worker))

    def note(what, share):
        noted.append((what, share))
        if last is None:
            process.stop()

    if error is None:
        assert process([], [], [], note, "a.csv") is last
    else:
        with pytest.raises(error, match=words):
            process([], [], [], note, "a.csv")
    assert noted == [("search", 0.5)]
    assert worker.ended == ["terminated", "joined", "closed"]


def test_diagnosis_ends_with_the_server_even_while_it_plans_an_experiment(monkeypatch, capsys):
    running = DiagnosisProcess()
    monkeypatch.setattr(processes, "RUNNING", {running})
    running.note("search", 0.5)
    processes.stop_diagnoses()
    with pytest.raises(StoppedError, match="nothing was changed"):
        running.note("design", 0.9)
    assert "so the diagnosis has no result" in capsys.readouterr().err
    processes.RUNNING.clear()
    processes.stop_diagnoses()
    assert capsys.readouterr().err == ""


def diagnosed_state(tmp_path, outcome):
    """State whose diagnosis is `outcome`, or fails with it; what is chosen changes by itself."""
    source = SimpleNamespace(path=tmp_path / "a.mcap", name="a.mcap")
    study = SimpleNamespace(folder=tmp_path, source=source)
    state = SimpleNamespace(study=study, diagnosis=None, use_of_runs="")
    state.choice = SimpleNamespace(channel="contact", effects=("bias",))

    def diagnose(channel, *, progress, judge):
        assert channel == "contact"
        progress("search", 0.256)
        state.seen()
        if isinstance(outcome, Exception):
            raise outcome
        state.diagnosis = outcome
        return outcome

    study.diagnose, study.diagnosis_to_save = diagnose, lambda found: {"channels": [found.channel]}
    return state


def test_diagnosis_shows_its_progress_then_its_verdict_and_steps(browser, tmp_path):
    found = diagnosis(
        RELAXATION, SHAPE, accepted=[("bias", "exact"), ("lag", "exact"), ("drift", "approximate")]
    )
    state, added, done, more = diagnosed_state(tmp_path, found), [], [], []

    async def add(effects):
        added.append(list(effects))

    async def work():
        card = DiagnosisCard(state, add, lambda: done.append(True))
        card.build(lambda: more.append(True))
        start, stop = browser.marked("diagnose"), browser.marked("stop")
        assert (start.visible, stop.visible) == (True, False)

        def seen():
            with browser.client:
                card._show_progress()
            assert (card._what.text, card._bar.value) == ("search", 0.26)
            assert (start.visible, stop.visible, card._bar.visible) == (False, True, True)
            card.stop()
            assert processes.running_diagnosis()._stop.is_set()

        state.seen = seen
        await card.start()
        card._show_progress()
        assert (start.visible, stop.visible, len(done), len(more)) == (True, False, 1, 1)
        assert (tmp_path / RESULT).read_text().strip().startswith("{")
        assert {"missing"} <= set(browser.marked("verdict").classes)
        assert browser.marked("budget").props["title"] == elements.BUDGET
        assert [each for each in browser.all() if each.tag == "img"]
        await browser.press("Add lag")
        await browser.press("Add lag + drift")
        assert added == [["lag"], ["lag", "drift"]]
        card.offer(("bias", "lag", "drift"))
        assert not [each for each in browser.all(ui.button) if each.text.startswith("Add")]
        card.stop()  # nothing runs
        for found, count in ((diagnosis(RELAXATION), 1), (diagnosis(verdict="adequate", noise=1.0), 0)):
            state.diagnosis = found
            card._show()  # a picture of several parts
            assert len([each for each in browser.all() if each.tag == "img"]) == count

    browser.use(work)


def test_diagnosis_of_other_runs_is_shown_and_stopped_and_none_that_ends_early_is_missed(browser, tmp_path):
    state, running, done = diagnosed_state(tmp_path, None), DiagnosisProcess("b.mcap contact"), []

    async def work():
        processes.RUNNING.add(running)
        card = DiagnosisCard(state, None, lambda: done.append(True))
        card.build()
        card._show_progress()
        assert browser.marked("stop").visible
        assert card._what.text == "b.mcap contact: starting the process of the diagnosis"
        card.stop()
        assert running._stop.is_set()
        card = DiagnosisCard(state, None, lambda: done.append(True))
        card.build(lambda: None)
        processes.RUNNING.clear()
        state.diagnosis = diagnosis(RELAXATION)
        card._show_progress()
        assert done == [True]

    browser.use(work)


@pytest.mark.parametrize("is_stopped_elsewhere", [False, True])
def test_failed_diagnosis_states_its_reason(browser, tmp_path, monkeypatch, is_stopped_elsewhere):
    monkeypatch.setattr(diagnosis_module, "_POLL_S", 0.0)
    state = diagnosed_state(tmp_path, StoppedError("stopped; nothing was changed"))
    done = []

    async def work():
        card = DiagnosisCard(state, None, lambda: done.append(True))
        card.build()
        state.seen = lambda: None
        if is_stopped_elsewhere:  # another tab's diagnosis runs, and ends
            processes.RUNNING.add(other := DiagnosisProcess())
            card._show_progress()
            waiting = asyncio.create_task(card.start())
            await asyncio.sleep(0)
            other.failure = "stopped; nothing was changed"
            processes.RUNNING.clear()
            await waiting
        else:
            await card.start()
        card._show_progress()
        assert browser.said == ["stopped; nothing was changed"]
        assert not done
        assert not (tmp_path / RESULT).exists()
        assert not processes.RUNNING

    browser.use(work)


@pytest.mark.parametrize(
    ("hidden", "rated"), [("lag", "right"), ("delay", "accepted as right"), (None, ""), ("spoilt", "")]
)
def test_riddle_opens_the_answer_only_after_a_diagnosis(browser, tmp_path, monkeypatch, hidden, rated):
    entry = SimpleNamespace(effect="lag", confused_with=["delay"])
    state = diagnosed_state(tmp_path, None)
    monkeypatch.setattr(diagnosis_module.Session, "open", lambda path: path)
    answer = SimpleNamespace(hidden=[SimpleNamespace(name=hidden)])

    def open_answer(session):
        if hidden == "spoilt":
            raise InputError("the answer is damaged")
        return answer

    monkeypatch.setattr(diagnosis_module, "open_answer", open_answer)

    async def diagnose():
        assert not browser.marked("guess").enabled
        state.diagnosis = hidden and SimpleNamespace(accepted=[entry])

    async def work():
        riddle_card(state, diagnose)
        await browser.press("That is it")
        assert browser.marked("guess").enabled
        said = browser.marked("score").text
        expected = {
            None: "the diagnosis was stopped, so the sealed answer was not opened",
            "spoilt": "the answer is damaged",
        }
        words = f"The hidden effect: {hidden}. You said bias: wrong. The diagnosis said lag: {rated}"
        assert said.startswith(expected.get(hidden, words))
        assert "Riddle" in [each.text for each in browser.all() if each.tag == "h2"]
        assert any("Tick effects until" in text for text in browser.texts())

    browser.use(work)


@pytest.mark.parametrize(("most", "again"), [(6, []), (1, ["base", "bias", "adhesion"])])
def test_prefetched_chain_is_fitted_once_while_kept_and_errors_are_answered(data, monkeypatch, most, again):
    monkeypatch.setattr(processes, "_MOST", most)
    channel, fits, answers = Study(data, keep=False).channel("contact"), [], []
    fit_extended, fit_base = processes.fit_extended, processes.fit_base
    monkeypatch.setattr(processes, "end_with_parent", lambda: None)
    monkeypatch.setattr(processes.os, "nice", fits.append)
    monkeypatch.setattr(
        processes, "fit_extended", lambda *what: fits.append(what[2].name) or fit_extended(*what)
    )
    monkeypatch.setattr(processes, "fit_base", lambda *what: fits.append("base") or fit_base(*what))
    requests = [("bias",), ("bias", "adhesion"), ("nobody",), ("bias", "adhesion"), EOFError()]
    pipe = Worker(*requests)
    pipe.send = answers.append
    processes._fit_ahead(pipe, channel, [EFFECTS[name]() for name in ("bias", "adhesion")])
    assert fits == [10, "base", "bias", "adhesion", *again]
    assert isinstance(answers[2], KeyError)


def test_other_files_are_offered_newest_first(browser, monkeypatch, tmp_path):
    names = ["old.csv", *(f"{number}.npz" for number in range(12))]
    names += ["new.CSV.gz", "a.mcap", "b.mcap", "note.txt", "folder.csv"]
    for age_s, name in enumerate(names):
        (tmp_path / name).mkdir() if name.startswith("folder") else (tmp_path / name).touch()
        os.utime(tmp_path / name, (age_s, age_s))
    opened, followed = [], []
    monkeypatch.setattr(layout, "is_session", lambda path: path.suffix == ".mcap")
    monkeypatch.setattr(file_drop, "is_session", lambda path: path.suffix == ".mcap")
    monkeypatch.setattr(layout, "newest_growing", lambda folder: folder / "b.mcap")
    monkeypatch.setattr(
        layout, "live_view", lambda session, done, feed: followed.append((session.name, done))
    )
    home = AppState(tmp_path, tmp_path / "old.csv", error="unreadable", riddle=True)
    home.open = lambda path, options: opened.append(path.name) or f"state of {path.name}"

    async def work():
        await layout.lay_out_page(home)
        assert browser.marked("refused").text == "unreadable"
        assert "palpate workbench" in browser.texts()
        assert browser.marked("probe").text == "Probe the simulated arm"
        begin, follow = browser.timers  # of a correction of its columns, and of other tabs
        assert begin.once
        follow.work()
        assert browser.reloads == 0
        await begin.work()
        assert "old.csv: no rows of data" in browser.marked("problem").text
        buttons = [each.text for each in browser.all(ui.button)]
        assert buttons[:4] == ["b.mcap", "a.mcap", "new.CSV.gz", "11.npz"]
        assert buttons[11:13] == ["3.npz", "All sessions of the folder as one study"]  # twelve files
        await browser.press("a.mcap")
        assert (home.state, home.error, home.riddle, browser.reloads) == ("state of a.mcap", "", False, 1)
        follow.work()  # as in another tab
        assert browser.reloads == 2
        await browser.press("All sessions of the folder as one study")
        ((session, done),) = followed
        await done(tmp_path / session)
        assert opened == ["a.mcap", tmp_path.name, "b.mcap"]

    browser.use(work)


@pytest.mark.parametrize("failed", ["", "the arm is off"])
def test_probing_from_the_page_is_followed_and_joined(browser, monkeypatch, tmp_path, failed):
    ran, followed = [], []

    async def run(arguments, on_line):
        ran.append(arguments)
        return failed

    monkeypatch.setattr(layout, "run_command", run)
    monkeypatch.setattr(layout, "live_view", lambda session, done, feed: followed.append((session, done)))
    home = AppState(tmp_path)
    home.state = SimpleNamespace(joined_with=lambda path: f"with {path.name}")
    home.open = lambda path, options: f"only {path.name}"

    async def work():
        place = ui.element("div")
        for number, join in enumerate((True, False), 1):
            await layout._probe(home, ["--seed", "3"], place, join=join)
            out = str(tmp_path / f"workbench-{number}.mcap")
            assert ran[-1] == ["probe", "--seed", "3", "--out", out]
            assert f"palpate probe --seed 3 --out {out}" in browser.texts()
            assert ("the arm is off" in browser.texts()) is bool(failed)
            session, done = followed[-1]
            assert str(session) == out
            await done(session)
            assert home.state == f"{'with' if join else 'only'} workbench-{number}.mcap"
            home.state = SimpleNamespace(joined_with=home.state) if not join else home.state
        assert browser.reloads == 2

    browser.use(work)


@pytest.mark.parametrize("failed", ["", "no touch"])
def test_resolve_runs_in_the_probed_world_and_opens_its_result(browser, monkeypatch, tmp_path, failed):
    async def run(arguments, on_line):
        assert arguments == ["resolve", "--seed", "3", "--out", str(tmp_path / "resolve-1")]
        on_line("round 1")
        return failed

    monkeypatch.setattr(layout, "run_command", run)
    monkeypatch.setattr(layout, "same_world", lambda session: world)
    session = SimpleNamespace(metadata=SimpleNamespace(extra={"source": "simulated"}))
    study = SimpleNamespace(source=SimpleNamespace(session=session), folder=tmp_path)
    state = SimpleNamespace(study=study, diagnosis=SimpleNamespace(next_experiment=object()))
    home, pushed = AppState(tmp_path), []
    home.open = lambda path, options: path.name
    monkeypatch.setattr(ui.log, "push", lambda log, line: pushed.append(line))

    async def work():
        nonlocal world
        layout._next_step(home, state)
        await browser.press("Resolve: probe until one explanation is left")
        assert pushed == ["round 1", *([failed] if failed else [])]
        assert home.state == (None if failed else "resolve-1")
        world = None
        layout._next_step(home, state)
        assert elements.SEALED in browser.texts()
        count, world = len(browser.all(ui.button)), "--drivers a.py"
        layout._next_step(home, state)  # code of somebody else
        state.diagnosis = None
        layout._next_step(home, state)
        assert [each.text for each in browser.all(ui.button)][count:] == ["Run it on the robot"]

    world = "--seed 3"
    browser.use(work)


@pytest.mark.parametrize(
    ("script", "lines", "error"),
    [
        ("echo one; echo two", ["one", "two"], ""),
        ("echo one; (echo why; echo no arm) >&2; exit 2", ["one"], "no arm"),
        ("exit 1", [], "it failed"),
    ],
)
def test_command_s_lines_are_passed_on_and_its_error_is_its_last(monkeypatch, script, lines, error):
    start, started = asyncio.create_subprocess_exec, []

    def start_script(*command, **options):
        started.append(command[3:])
        return start("sh", "-c", script, **options)

    monkeypatch.setattr(live.asyncio, "create_subprocess_exec", start_script)
    said = []
    assert asyncio.run(live.run_command(["probe", "--seed", "3"], said.append)) == error
    assert (said, started) == (lines, [("palpate.main", "probe", "--seed", "3")])
