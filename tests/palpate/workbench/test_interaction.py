"""The page without a browser: what its elements show, and what they do when they are used."""

import asyncio
import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from nicegui import Client, core, events, ui
from nicegui.page import page

from palpate.common import console
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.measurement_noise import MeasurementNoise, NoiseSource
from palpate.render.terminal import with_interval
from palpate.robot_io.errors import InputError
from palpate.study import Study
from palpate.workbench import effects as effects_module
from palpate.workbench import elements, plots
from palpate.workbench import page as page_module
from palpate.workbench.effects import EffectRows, open_gallery
from palpate.workbench.elements import Plot
from palpate.workbench.layout import lay_out_page
from palpate.workbench.page import Page
from palpate.workbench.startup import AppState
from palpate.workbench.state import EffectEvidence, ModelSelection, WorkbenchState
from tests.few_effects import try_few_effects
from tests.palpate.presses import STIFFNESS, write_presses


class Browser:
    """Finds elements of a page in this process, and sends their events; keeps what the page says."""

    def __init__(self, monkeypatch):
        self.said, self.timers, self.reloads, self._tasks, self.failed = [], [], 0, [], []
        monkeypatch.setattr(ui, "timer", self._time)
        monkeypatch.setattr(ui, "notify", lambda text, **_: self.said.append(text))
        monkeypatch.setattr(ui.navigate, "reload", self._reload)
        monkeypatch.setattr(core.app, "handle_exception", self.failed.append)
        later = SimpleNamespace(
            create_or_defer=lambda work, **_: self._tasks.append(asyncio.create_task(work))
        )
        monkeypatch.setattr(events, "background_tasks", later)

    def _time(self, period_s, work, once=False):
        self.timers.append(SimpleNamespace(period_s=period_s, work=work, once=once, active=True))
        self.timers[-1].deactivate = partial(setattr, self.timers[-1], "active", False)
        return self.timers[-1]

    def _reload(self):
        self.reloads += 1

    def use(self, work):
        """Run `work` on a new page."""

        async def run():
            core.loop = asyncio.get_running_loop()
            with Client(page("")) as self.client:
                await work()

        asyncio.run(run())
        assert not self.failed

    def all(self, kind=ui.element, **props):
        named = {name.replace("_", "-"): value for name, value in props.items()}
        return [
            each for each in self.client.elements.values()
            if isinstance(each, kind) and named.items() <= each.props.items()
        ]  # fmt: skip

    def marked(self, mark):
        (found,) = (each for each in self.client.elements.values() if mark in each._markers)
        return found

    def texts(self):
        return [each.text for each in self.all(ui.label)]

    async def send(self, element, event, args=None):
        for listener in list(element._event_listeners.values()):
            if listener.type == event:
                sent = events.GenericEventArguments(sender=element, client=self.client, args=args)
                events.handle_event(listener.handler, sent)
        await self.settle()

    async def press(self, text):
        (button,) = (each for each in self.all(ui.button) if each.text == text)
        await self.send(button, "click")

    async def settle(self):
        while self._tasks:
            await self._tasks.pop()


@pytest.fixture
def browser(monkeypatch):
    return Browser(monkeypatch)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("press")
    with pytest.MonkeyPatch.context() as patch:
        try_few_effects(patch, "lag", "delay", "drift", "power_law_stiffness")
        return Study(write_presses(folder / "press.csv"), folder=folder / "results")


@pytest.fixture
def state(study):
    state = WorkbenchState(study, "press.csv")
    state.choice = ModelSelection("contact")  # not the newest revision
    return state


@pytest.fixture
def opened(browser, state, tmp_path):
    """Runs work on the page of `state`, after its first fit; all its fits are known afterwards."""

    def begin(work):
        async def shown():
            shown.page = Page(AppState(tmp_path, state=state), state, lambda: None, lambda: None)
            await shown.page.build()
            await shown.page._change(state.show)
            await work(shown.page)

        browser.use(shown)

    return begin


def stated_error(browser):
    """Error in large type, and the text beside it."""
    html = browser.marked("error").content
    return float(re.search(r'data-error="([^"]+)"', html)[1]), html


def interval(browser, name):
    (row,) = browser.all(data_parameter=name)
    value, text, *_ = [each.text for each in row.descendants() if isinstance(each, ui.label)]
    return value, text


def test_page_shows_the_fit_of_each_choice_and_its_steps(opened, browser, state, monkeypatch):
    async def work(page):
        base = state.show().fitted
        assert stated_error(browser)[0] == base.rmse
        assert "× noise level" in stated_error(browser)[1]
        assert 'class="fits"' not in stated_error(browser)[1]
        assert not page._undo.enabled
        assert {"press.csv", "base model kelvin_voigt"} <= set(browser.texts())
        offered, numbers = [], []
        rough = replace(state.show(state.toggled("cubic_stiffness")), is_rough=True)
        monkeypatch.setattr(state, "preview", lambda choice: rough)
        page._diagnosis.offer = offered.append
        shown = page._error._number.set_content
        page._error._number.set_content = lambda html: numbers.append(html) or shown(html)
        await page.tick("cubic_stiffness")
        assert offered == [("cubic_stiffness",)]
        assert ["data-rough" in number for number in numbers] == [True, False, False]  # preview, fit, judged
        fitted = state.show().fitted
        error, html = stated_error(browser)
        assert (error, state.choice.effects) == (fitted.rmse, ("cubic_stiffness",))
        assert "at the noise level" in html
        assert 'class="fits"' in html
        assert browser.marked("waterfall").content.count('class="step"') == 2
        assert "palpate add press.csv cubic_stiffness" in browser.marked("command").text
        assert browser.marked("python").text.startswith('study.add("cubic_stiffness", ')
        drawn = page._center._time.figure["data"]
        rows = page._center._motion.rows(base.data.effort, plots.MOST_POINTS)
        for trace, values in ((1, base.predict(base.values)), (2, fitted.predict(fitted.values))):
            np.testing.assert_allclose(drawn[trace]["y"], plots.picked(values, rows), atol=1e-3)
        np.testing.assert_array_equal(drawn[4]["y"], plots.picked(fitted.residual, rows))
        over_state = page._center._state_plot.figure["data"]
        assert np.nanmax(np.abs(over_state[0]["y"] - over_state[1]["y"])) < 0.15  # within the noise
        maps = page._center._map.figure["data"]
        assert np.nanstd(maps[1]["z"]) < 0.3 * np.nanstd(maps[0]["z"])
        for name in ("stiffness.k", "damping.c", "cubic_stiffness.k3"):
            # as diagnose and add print it
            value, half = with_interval(fitted.parameters[name])
            unit = fitted.parameters[name].unit
            assert interval(browser, name) == (f"{value} {unit}".removesuffix(" 1"), half)
        assert float(interval(browser, "stiffness.k")[0].split()[0]) == pytest.approx(STIFFNESS, rel=0.02)
        await page._step(state.undo)
        assert stated_error(browser)[0] == base.rmse
        assert not browser.all(data_parameter="cubic_stiffness.k3")
        assert (page._undo.enabled, page._redo.enabled) == (False, True)
        for key, expected in (("y", 1), ("z", 0), ("Z", 1), ("z", 0), ("x", 0)):
            pressed = SimpleNamespace(action=SimpleNamespace(keydown=True), key=SimpleNamespace(name=key))
            pressed.modifiers = SimpleNamespace(ctrl=True, shift=key.isupper())
            await page._key(pressed)
            assert len(state.choice.effects) == expected
        assert page._idle.is_set()
        await page.tick("no_such_effect")
        assert "no_such_effect" in browser.said[0]
        assert stated_error(browser)[0] == base.rmse

    opened(work)


def test_page_has_all_its_parts_with_their_explanations(opened, browser):
    async def work(page):
        headings = [each.text for each in browser.all() if each.tag == "h2"]
        assert headings == [
            "What is missing?", "Effects", "Curves", "Over position and velocity",
            "Residual over position and velocity", "Error in held-out runs", "Parameters",
            "Are these data fit for a diagnosis?", "Equivalent commands", "Revisions",
        ]  # fmt: skip
        titles = {each.props.get("title") for each in browser.all()}
        assert {elements.DIAGNOSE, elements.CURSORS, elements.INTERVAL, f"Keep: {elements.KEEP}"} <= titles
        assert "good" in browser.marked("gates").content
        assert browser.all(ui.keyboard)
        await open_gallery(page.state, "cubic_stiffness")
        effect = EFFECTS["cubic_stiffness"]()
        texts = {effect.physics, f"Signature: {effect.signature}.", effect.equation}
        assert texts <= set(browser.texts())
        experiments = [text for text in browser.texts() if text.startswith("Separate it from")]
        assert len(experiments) == len(effect.confused_with)
        (dialog,) = browser.all(ui.dialog)
        assert dialog.value
        await browser.press("Close")
        assert not dialog.value

    opened(work)


def test_slider_moves_all_views_until_its_parameter_is_held_or_freed(opened, browser, state):
    async def work(page):
        fitted = state.show().fitted
        (slider,) = browser.all(ui.slider, aria_label="stiffness.k")
        assert slider.props["min"] < 0.5 * fitted.values["stiffness.k"] < 2.0 * slider.props["max"]
        assert slider.props["min"] == pytest.approx(max(-fitted.values["stiffness.k"], 0.0))
        assert slider.props["max"] == pytest.approx(3.0 * fitted.values["stiffness.k"])
        assert slider.props["step"] == pytest.approx((slider.props["max"] - slider.props["min"]) / 200)
        assert not page._parameters._back.visible
        await browser.send(slider, "update:modelValue", 500.0)
        await browser.send(slider, "change", 510.0)
        values = fitted.values | {"stiffness.k": 510.0}
        left = (fitted.data.effort - fitted.predict(values))[state.show().base.scored]
        assert stated_error(browser)[0] == pytest.approx(np.sqrt(np.mean(left**2)))
        assert "at these values" in stated_error(browser)[1]
        assert float(interval(browser, "stiffness.k")[0].removesuffix(" N/m")) == 510.0
        assert "moved sliders" in browser.marked("waterfall").content
        assert re.fullmatch(r"fit: [\d.]+ ± [\d.]+", interval(browser, "stiffness.k")[1])
        assert page._parameters._back.visible
        assert page._undo.enabled
        center, predicted = page._center, fitted.predict(values)
        motion = center._motion
        for plot, trace, rows in (
            (center._time, 2, motion.rows(fitted.data.effort, plots.MOST_POINTS)),
            (center._state_plot, 1, plots._state_rows(motion)),
        ):
            np.testing.assert_array_equal(plot.figure["data"][trace]["y"], plots.picked(predicted, rows))
        shown = stated_error(browser)
        map_before = center._map.figure["data"][1]["z"]
        await page._step(state.undo)
        assert state.choice.slider_values == {}  # both moves are one step
        assert stated_error(browser)[0] == fitted.rmse
        map_of_fit = center._map.figure["data"][1]["z"]
        assert np.nanstd(map_before) > 1.3 * np.nanstd(map_of_fit)
        await page._step(state.redo)
        assert stated_error(browser) == shown
        for name in ("bias.b", "stiffness.k"):  # another model is being fitted
            await page.move_slider(name, 1.0)
            state.choice, chosen = replace(state.choice, effects=("bias",)), state.choice
        assert stated_error(browser) == shown
        state.choice = replace(chosen, effects=())
        await browser.send(browser.all(ui.button, aria_label="hold stiffness.k")[0], "click")
        assert state.choice.held == {"stiffness.k": 510.0}
        assert interval(browser, "stiffness.k") == ("510 N/m", "held")
        assert "held and bounded" in browser.marked("waterfall").content
        (lock,) = browser.all(ui.button, aria_label="hold stiffness.k")
        assert lock.props["icon"] == "lock"
        await browser.send(browser.all(ui.slider, aria_label="stiffness.k")[0], "change", 520.0)
        assert interval(browser, "stiffness.k")[1] == "held at 510"
        await browser.press("back to the fit")
        assert state.choice.slider_values == {}
        assert not page._parameters._back.visible
        await browser.send(lock, "click")
        assert state.choice.held == {}
        assert stated_error(browser)[0] == fitted.rmse

    opened(work)


def test_bounds_are_asked_for_and_applied(opened, browser, state):
    async def work(page):
        async def ask():
            await browser.send(browser.all(ui.button, aria_label="bound damping.c")[0], "click")
            return browser.all(ui.number)[-2:]

        (slider,) = browser.all(ui.slider, aria_label="damping.c")
        lower, upper = await ask()
        assert (lower.value, upper.value) == pytest.approx(
            (slider.props["min"], slider.props["max"]), rel=1e-3
        )
        lower.value = None
        await browser.press("Apply")
        assert "the bounds are empty and " in browser.said[0]
        assert "give two numbers" in browser.said[0]
        lower.value, upper.value = 50.0, 60.0
        await browser.press("Apply")
        assert not any(each.value for each in browser.all(ui.dialog))
        assert state.choice.bounds == {"damping.c": (50.0, 60.0)}
        assert interval(browser, "damping.c")[1] == "within 50 to 60, held at this bound"
        for each in browser.all(ui.dialog):
            await browser.send(each, "hide")
        assert not browser.all(ui.dialog)
        assert [each.value for each in await ask()] == [50.0, 60.0]
        await browser.press("Remove")
        assert state.choice.bounds == {}
        await ask()
        await browser.press("Remove")  # it is free already
        assert not any(each.value for each in browser.all(ui.dialog))

    opened(work)


def test_effects_are_ranked_by_the_error_that_they_remove(opened, browser, state):
    async def fit(effects):
        if "delay" in effects:
            raise InputError("too few samples")

    async def work(page):
        listed = page._effects
        listed.fill()
        rows = listed._rows.by_name
        assert "polyline" in rows["cubic_stiffness"]["picture"]
        assert not any(row["chosen"] for row in rows.values())
        names = ("cubic_stiffness", "delay", "drift", "bias")
        listed._effects = {name: listed._effects[name] for name in names}
        ahead = SimpleNamespace(fit=fit)
        assert await listed._evaluate_extensions((), ahead, page._idle)
        assert (rows["delay"]["mark"], rows["delay"]["about"]) == ("–", "too few samples")
        cubic = rows["cubic_stiffness"]
        share = 1.0 - state.show(state.toggled("cubic_stiffness")).fitted.rmse / state.show().fitted.rmse
        assert share > 0.5
        shown = f"−{100 * share:.0f} %", "strong", round(44 * share)
        assert (cubic["mark"], cubic["look"], cubic["share"]) == shown
        assert rows["drift"]["look"] == "quiet"
        assert 0 <= rows["drift"]["share"] <= 3
        assert sorted(names, key=lambda name: rows[name]["order"])[0] == "cubic_stiffness"
        assert -1000 <= cubic["order"] == round(-1000 * share) < rows["drift"]["order"] <= 0
        listed.show(("lag",))
        assert rows["drift"]["look"] == "stale"  # its share is that beside other effects
        assert rows["lag"]["order"] == -3000  # above all others, until its share is known
        await browser.send(listed._rows, "tick", "cubic_stiffness")
        assert cubic["chosen"]
        assert cubic["order"] == round(-1000 * share) - 2000  # above all that are not chosen
        listed._evidence, listed.arrange = [], lambda: None  # the order before all effects are known
        assert await listed._evaluate_extensions(state.choice.effects, ahead, page._idle)
        assert rows["drift"]["look"] == "quiet"
        assert cubic["order"] == round(-1000 * share) - 2000
        assert not await listed._evaluate_extensions((), ahead, page._idle)  # the selection has changed
        (text,) = browser.all(ui.input, aria_label="filter effects")
        text.value = " DRift "
        assert [name for name, row in rows.items() if row["seen"]] == ["drift"]
        text.value = None
        assert all(row["seen"] for row in rows.values())

    opened(work)


def test_indistinguishable_effects_share_a_frame(opened, state, monkeypatch):
    async def work(page):
        listed = page._effects
        listed.fill()
        rows, (one, other) = listed._rows.by_name, np.eye(2)
        listed._evidence = [
            EffectEvidence("bias", 0.3, one),
            EffectEvidence("delay", 0.4, other),
            EffectEvidence("drift", 0.2, -one),
        ]
        listed.arrange()
        assert [name for name, row in rows.items() if row["alike"]] == ["bias", "drift"]
        assert rows["drift"]["together"] == "hard to tell apart in these data: bias, drift"
        assert [rows[name]["order"] for name in ("delay", "bias", "drift")] == [-400, -300, -300]
        state.choice = replace(state.choice, effects=("drift",))
        listed._evidence = listed._evidence[1:]  # bias counts as drift once drift is chosen
        listed.arrange()
        assert [name for name, row in rows.items() if row["alike"]] == ["bias", "drift"]
        assert rows["bias"]["order"] == rows["drift"]["order"] == -2200
        # a diagnosis decides, whichever effect removes more of the error
        named = SimpleNamespace(effect="lag", confused_with=["delay"])
        monkeypatch.setattr(WorkbenchState, "diagnosis", SimpleNamespace(accepted=[named]))
        listed.arrange()
        assert [name for name, row in rows.items() if row["alike"]] == ["lag", "delay"]
        assert rows["lag"]["order"] == rows["delay"]["order"] == -400
        page._effects._evidence = []
        page._effects.fill()  # before any evidence; single effects keep their places
        rows = page._effects._rows.by_name
        assert [name for name, row in rows.items() if row["alike"]] == ["lag", "delay"]
        assert (rows["delay"]["order"], rows["bias"]["order"]) == (0, 1000)

    opened(work)


def test_only_changed_fields_of_rows_are_sent(browser):
    async def work():
        rows, sent = EffectRows([{"name": "a", "x": 1, "y": 2}, {"name": "b", "x": 1, "y": 2}]), []
        rows.run_method = lambda *message: sent.append(message)
        rows.change({"a": {"x": 5}})
        assert sent == []  # the browser is not ready
        await browser.send(rows, "ready")
        rows.change({"a": {"x": 5, "y": 3}, "b": {"x": 1}})
        rows.change({"a": {"x": 5}})
        assert [method for method, _ in sent] == ["change", "change"]
        assert sent[0][1]["a"] == {"name": "a", "x": 5, "y": 3}
        assert sent[1][1] == {"a": {"y": 3}}

    browser.use(work)


def test_gallery_simulates_an_effect_with_sliders(opened, browser, state):
    async def work(page):
        await open_gallery(state, "cubic_stiffness")
        (plot,), (slider,) = browser.all(Plot)[-1:], browser.all(ui.slider, aria_label="cubic_stiffness.k3")
        before = plot.figure["data"][1]["y"]
        effect = before - plot.figure["data"][0]["y"]
        assert slider.value == 50.0  # a decade on either side, logarithmic
        await browser.send(slider, "update:modelValue", 75.0)
        drawn = plot.figure["data"]
        change = drawn[1]["y"] - drawn[0]["y"]
        largest = np.nanargmax(np.abs(effect))
        assert change[largest] / effect[largest] == pytest.approx(10**0.5, rel=1e-3)
        np.testing.assert_array_equal(drawn[3]["y"], drawn[1]["y"])
        assert [trace["name"] for trace in drawn] == ["base model", "with it"] * 2
        assert [trace["showlegend"] for trace in drawn] == [True, True, False, False]
        assert [text for text in browser.texts() if text.startswith("k3 = ")]
        await browser.send(browser.all(ui.dialog)[0], "hide")
        assert not browser.all(ui.dialog)
        # linear over a narrow typical range, logarithmic over decades
        for name, step, value, unit in (
            ("power_law_stiffness.n", 75.0, 3.1, "1"),
            ("lag.tau", 0.0, 0.001, "s"),
            ("lag.tau", 50.0, 0.2**0.5 * 0.001**0.5, "s"),
        ):
            effect, _, parameter = name.partition(".")
            await open_gallery(state, effect)
            slider = browser.all(ui.slider, aria_label=name)[-1]
            begins = browser.texts()
            await browser.send(slider, "update:modelValue", slider.value)
            assert browser.texts() == begins
            await browser.send(slider, "update:modelValue", step)
            assert f"{parameter} = {with_unit(value, unit)}" in browser.texts()

    opened(work)


def test_cursors_read_the_curves_and_runs_are_chosen(opened, browser, state):
    async def work(page):
        center, motion = page._center, page._center._motion
        effort, model = motion.data.effort, center._drawn[0]
        first, second = (
            next(each for each in browser.all(ui.number) if each.label == f"{name} [s]") for name in "AB"
        )
        at = [int(np.searchsorted(motion.time_s, time_s)) for time_s in (0.5, 0.9)]
        await browser.send(center._time, "point", motion.time_s[at[0]])
        await browser.send(center._time, "point", motion.time_s[at[1]])
        text = browser.marked("reading").content.replace("&nbsp;", "").replace("<b>", "").replace("</b>", "")
        a, b, apart = (part.strip() for part in re.split(r"(?=B −|B [-\d])", text))
        assert (float(a.split()[1]), float(b.split()[1])) == pytest.approx(effort[at], abs=1e-3)
        assert f"model {model[at[0]]:.4g}, left {effort[at[0]] - model[at[0]]:+.3g}" in a
        change_s, change_n = motion.time_s[at[1]] - motion.time_s[at[0]], effort[at[1]] - effort[at[0]]
        assert apart.startswith(f"B − A {change_s:.4g} s, {change_n:+.4g} N, depth ")
        assert float(apart.split()[-2]) == pytest.approx(np.diff(motion.position[at])[0], rel=1e-3)
        await browser.send(center._time, "point", 0.70004)
        assert (first.value, second.value) == (0.7, round(float(motion.time_s[at[1]]), 4))
        first.value = 999.0
        shapes = center._time.figure["layout"]["shapes"]
        assert [shape["x0"] for shape in shapes] == [second.value, motion.time_s[-1]]
        await browser.send(first, "blur")
        assert first.value == motion.time_s[-1]
        first.value = second.value = None
        assert center._time.figure["layout"]["shapes"] == []
        assert browser.marked("reading").content == ""
        await browser.send(center._time, "zoom", [1.0, 1.5])
        assert {*np.round(center._time.figure["data"][0]["x"][[0, -1]], 2)} == {1.0, 1.5}
        await browser.send(center._time, "zoom", None)
        assert np.nanmax(center._time.figure["data"][0]["x"]) == np.float32(motion.time_s[-1])
        (drawn,) = browser.all(ui.select, aria_label="runs to draw")
        drawn.value = [2]
        assert set(
            motion.data.run[np.isin(motion.time_s.astype(np.float32), center._time.figure["data"][0]["x"])]
        ) == {2}
        over_state = center._state_plot.figure["data"][1]["y"]
        np.testing.assert_array_equal(over_state, plots.picked(model, plots._state_rows(center._motion)))
        out, scored = (
            browser.all(ui.select, aria_label=f"runs to {what}")[0] for what in ("leave out", "hold out")
        )
        out.value = list(out.options)
        await browser.settle()
        assert browser.said == ["keep at least one run of each channel"]
        assert (out.value, browser.reloads) == ([], 0)
        await browser.send(out, "popupShow")
        out.value = [1]
        await browser.settle()
        assert browser.reloads == 0  # until the list is closed
        await browser.send(out, "popupHide")
        assert (page._home.state.out, browser.reloads) == ((1,), 1)
        out.value, scored.value = [], [3]
        await browser.settle()
        assert page._home.state.study.held_out == (3,)

    opened(work)


def test_kept_revisions_are_listed_and_shown_again(opened, browser, state, monkeypatch):
    async def work(page):
        await browser.press("Keep")
        assert browser.said == ["nothing has been added yet: tick an effect first"]
        assert "no revisions yet" in browser.texts()
        await page.add(["cubic_stiffness"])
        await page.add(["cubic_stiffness"])
        assert state.choice.effects == ("cubic_stiffness",)
        assert not state.is_saved
        await browser.press("Keep")
        place = console.display_path(state.study.folder)
        assert browser.said[1:] == [f"kept as revision 1 in {place}"]
        assert state.is_saved
        assert not any(text.startswith("no revisions") for text in browser.texts())
        await page.move_slider("stiffness.k", 1.0)
        await browser.press("Keep")
        assert browser.said[2:] == [f"kept as revision 2 in {place}{elements.NOT_KEPT}"]
        await page.tick("cubic_stiffness")
        error = state.study.revisions[-1].rmse
        await browser.press(f"1 · {with_unit(error, 'N')} · kelvin_voigt + cubic_stiffness")
        assert stated_error(browser)[0] == error
        monkeypatch.setattr(state.study, "folder", None)
        await browser.press("Keep")
        assert browser.said[3] == "kept as revision 3 in memory only"
        page.state = state.with_runs((1,), ())
        page._list_revisions()
        assert "no revisions of this channel with these runs yet" in browser.texts()
        await page.save_revisions()
        assert browser.said[4].endswith("(runs left out: 1)")

    opened(work)


def test_page_follows_what_other_tabs_choose(opened, browser, state, monkeypatch):
    async def work(page):
        (follow,) = (each.work for each in browser.timers if each.period_s == 0.5)
        before = stated_error(browser)[0]
        page._idle.clear()
        state.choose(state.toggled("cubic_stiffness"))
        await follow()
        assert stated_error(browser)[0] == before  # a fit of its own is running
        page._idle.set()
        await follow()
        assert stated_error(browser)[0] == state.show().fitted.rmse < before
        (channel,) = browser.all(ui.select, aria_label="channel")
        assert channel.options == {"contact": "contact · contact force"}
        monkeypatch.setattr(state, "to_channel", chosen.append)
        channel.value = None
        await browser.settle()
        assert (chosen, browser.reloads) == ([None], 1)

        def refuse(name):
            raise InputError("too few samples")

        monkeypatch.setattr(state, "to_channel", refuse)
        channel.value = "contact"  # its raw curves are shown
        await browser.settle()
        assert (state.choice, browser.reloads) == (ModelSelection("contact"), 2)
        state.choice = replace(state.choice, channel="joint_1")
        await follow()
        assert browser.reloads == 3
        state.choice = replace(state.choice, channel="contact")
        page._home.state = state.with_runs((1,), ())  # or another file
        await follow()
        assert browser.reloads == 4
        page._home.state = state
        state.choice = replace(state.choice, channel="contact")

        def to_another_channel():
            state.choice = replace(state.choice, channel="joint_1")
            return state

        for undone in (to_another_channel, lambda: WorkbenchState(state.study), lambda: state):
            await page._step(undone)
            state.choice = replace(state.choice, channel="contact")
        assert (browser.reloads, page._home.state is state) == (6, False)

    chosen = []
    opened(work)


def test_refused_data_have_a_checklist_and_raw_curves_but_no_error(browser, tmp_path):
    short = write_presses(tmp_path / "short.csv")
    short.write_text("".join(short.read_text().splitlines(keepends=True)[:50]))
    state = WorkbenchState(Study(short, keep=False), "short.csv")

    async def work():
        home = AppState(tmp_path, state=state)
        await Page(home, state, lambda: None, lambda: None).build()
        checks = browser.marked("gates").content
        assert 'class="bad">✗ enough data' in checks
        assert checks.count(": not checked</li>") == checks.count("<li") - 1 > 2
        assert not [each for each in browser.client.elements.values() if "error" in each._markers]
        (follow,) = (each.work for each in browser.timers if each.period_s == 0.5)
        await follow()
        assert browser.reloads == 0
        home.state = WorkbenchState(state.study)
        await follow()
        assert browser.reloads == 1
        (time, *_) = browser.all(Plot)
        assert len(time.figure["data"][0]["y"]) == 49

    browser.use(work)


def test_notes_on_the_data_are_beside_their_checks(browser, state, monkeypatch):
    monkeypatch.setitem(vars(state.study), "notes", ("1 A <current> counts as 1 N m",))
    monkeypatch.setitem(vars(state.study), "warnings", {"contact": ["the force is large"]})

    async def work():
        page_module._data_checks(state)
        checks = browser.marked("gates").content
        assert "! 1 A &lt;current&gt; counts as 1 N m</li>" in checks
        assert "! contact: the force is large</li>" in checks

    browser.use(work)


def test_effects_are_ranked_again_after_each_choice_until_the_page_is_left(
    opened, browser, state, monkeypatch
):
    ranked, closed = [], []

    async def rank(chosen, ahead, idle):
        ranked.append(chosen)
        return len(ranked) != 2  # the second time, the choice changed on the way

    async def work(page):
        page._effects.fill()
        page._effects._evaluate_extensions = rank
        ranking = asyncio.create_task(page._effects.rank_effects(page._idle))
        for effects in ((), ("bias",)):
            state.choice = replace(state.choice, effects=effects)
            for _ in range(10):
                await asyncio.sleep(0.001)
        page._effects._card.delete()
        await ranking
        assert ranked == [(), ("bias",), ("bias",)]
        assert closed == [True]

    monkeypatch.setattr(effects_module, "_PAUSE_S", 0.0)
    ahead = SimpleNamespace(close=lambda: closed.append(True))
    monkeypatch.setattr(effects_module, "FitPrefetcher", lambda *_: ahead)
    opened(work)


def test_finished_diagnosis_renews_groups_and_noise(opened, browser, state, monkeypatch):
    async def work(page):
        page._effects.fill()
        arranged = []
        monkeypatch.setattr(page._effects, "arrange", lambda: arranged.append(True))
        page.on_diagnosed()
        noise = MeasurementNoise(9.0, NoiseSource.FREE_AIR, 9.0, 0.0)
        monkeypatch.setattr(state.study, "noise", lambda channel: noise)
        assert arranged == [True]
        assert browser.timers[-1].once
        await browser.timers[-1].work()
        assert "a flexible regression reaches" in stated_error(browser)[1]

    opened(work)


def test_other_files_are_offered_in_a_dialog(browser, state, tmp_path):
    (tmp_path / "other.csv").touch()
    home = AppState(tmp_path, state=state)

    async def work():
        await lay_out_page(home)
        await browser.press("Open")
        assert [each for each in browser.all(ui.button) if each.text == "other.csv"]
        (dialog,) = browser.all(ui.dialog)
        await browser.send(dialog, "hide")
        assert not browser.all(ui.dialog)

    browser.use(work)


@pytest.mark.parametrize("is_refused", [False, True])
def test_page_fits_first_and_then_ranks_the_effects_beside_the_riddle(
    browser, state, tmp_path, monkeypatch, is_refused
):
    ranked = []

    async def rank(idle):
        ranked.append(idle.is_set())

    def refuse():
        raise InputError("too few samples")

    async def work():
        page = Page(AppState(tmp_path, riddle=True), state, lambda: None, lambda: None)
        await page.build()
        assert browser.marked("guess").text == "That is it"
        monkeypatch.setattr(page._effects, "rank_effects", rank)
        if is_refused:
            monkeypatch.setattr(state, "show", refuse)
        (begin,) = (each for each in browser.timers if each.once)
        await begin.work()
        assert ranked == [] if is_refused else ranked == [True]
        assert browser.said == (["too few samples"] if is_refused else [])
        assert is_refused or stated_error(browser)[0] == state.show().fitted.rmse
        assert bool(page._effects._effects) is not is_refused

    browser.use(work)


def test_effect_that_cannot_be_simulated_says_why(opened, browser, state, monkeypatch):
    async def work(page):
        def refuse(*_):
            raise InputError("no arm")

        monkeypatch.setattr(effects_module.EffectExample, "on_fitted_motion", refuse)
        await open_gallery(state, "cubic_stiffness")
        assert browser.said == ["no arm"]
        assert not browser.all(ui.dialog)

    opened(work)
