"""Right panel of the page: error, waterfall, parameters, and equivalent commands."""

import math
from collections.abc import Awaitable, Callable, Mapping
from html import escape

from nicegui import events, ui

from palpate.common.console import significant
from palpate.estimation.estimate import ParameterEstimate, rounded, text_with_unit, with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.render.diagnosis import unphysical_remarks
from palpate.render.terminal import with_interval
from palpate.render.view import NOISE
from palpate.workbench import elements
from palpate.workbench.elements import errors_as_warnings, heading, set_props
from palpate.workbench.state import DisplayedFit, ModelSelection, WorkbenchState

Choose = Callable[[ModelSelection], Awaitable[None]]
_STEPS = 200  # steps of a slider


class ErrorCard:
    """The held-out error in large type, and its decrease by stage."""

    def __init__(self) -> None:
        self._judged: FitResult | None = None  # the newest fit that `judge` has shown

    def build_number(self) -> None:
        """Build the number, which stays visible."""
        self._number = ui.html("…").classes("error").mark("error").props("aria-live=polite")

    def build(self) -> None:
        """Build the elements that explain the number."""
        with ui.element("section").classes("card waterfall"):
            heading("Error in held-out runs", elements.ERROR)
            self._wrong = ui.label().classes("bad unphysical")
            self._fall = set_props(ui.html("").mark("waterfall"), title=elements.FALL)

    def show(self, shown: DisplayedFit) -> None:
        """Show the error of a fit; `judge` shows whether it is good."""
        unit, error = shown.fitted.data.effort_unit, shown.fitted.rmse
        self._number.set_content(_number(error, shown, elements.ROUGH if shown.is_rough else ""))
        self._fall.set_content(waterfall(shown.steps, shown.noise, unit))
        self._wrong.set_text("")
        if shown.fitted is self._judged:
            self.judge(shown)

    def judge(self, shown: DisplayedFit) -> None:
        """Show whether a fit with known intervals is good; a small error does not suffice."""
        self._judged = fit = shown.fitted
        # with this model; the noise level of the channel was estimated with the base model
        least = fit.smooth_law_error
        more = fit.rmse > NOISE * least
        is_hidden = more and fit.rmse < NOISE * shown.noise.value
        reached = with_unit(least, fit.data.effort_unit)
        comparison = f"a flexible regression reaches {reached}" if is_hidden else ""
        kind = "" if more or fit.unphysical else "fits"
        self._number.set_content(_number(fit.rmse, shown, comparison, kind))
        self._wrong.set_text(" ".join(unphysical_remarks(fit.unphysical)))

    def preview(self, shown: DisplayedFit, error: float) -> None:
        """Show the error at the values of the sliders, as a further bar below those of the fits.

        Args:
            shown: the fit whose sliders were moved.
            error: error at the sliders' values, in the effort's unit.
        """
        self._wrong.set_text("")  # applies to the fit only
        self._number.set_content(_number(error, shown, "at these values"))
        steps = (*shown.steps, ("moved sliders", error))
        self._fall.set_content(waterfall(steps, shown.noise, shown.fitted.data.effort_unit))


def _number(error: float, shown: DisplayedFit, what: str = "", kind: str = "") -> str:
    noise, unit = shown.noise, shown.fitted.data.effort_unit
    times = error / noise.value if noise.value > 0.0 else math.inf
    at_noise = times < NOISE and not shown.is_incomplete
    beside = f"{'≥ ' * noise.is_bound}{times:.1f} × noise level"
    if at_noise:
        beside = "may be noise" if noise.is_bound else "at the noise level"
    is_rough = what == elements.ROUGH
    return (
        f'<b data-error="{error!r}"{" data-rough" * is_rough} class="{kind if at_noise else ""}" '
        f'title="{elements.ERROR}">{"≈ " * is_rough}{with_unit(error, unit)}</b> '
        f'<span class="quiet" title="{elements.NOISE_LEVEL}">{what or beside}</span>'
    )


def waterfall(steps: tuple[tuple[str, float], ...], noise: MeasurementNoise, unit: str) -> str:
    """Return the error of each stage as bars, with the noise level as a line.

    Args:
        steps: label and held-out error of each stage.
        noise: noise of the channel.
        unit: unit of the effort.
    """
    most = max(error for _, error in steps) or 1.0
    rows, before = [], steps[0][1]
    for label, error in steps:
        falls = f" −{100 * (1 - error / before):.0f} %" if error < 0.995 * before else ""
        kind = "base" if label == steps[0][0] else ""
        rows.append(
            f'<div class="step"><span class="label">{escape(label)}</span><span class="track">'
            f'<i class="{kind}" style="width:{100 * error / most:.1f}%"></i>'
            f'<u style="left:{100 * min(noise.value / most, 1.0):.1f}%"></u></span>'
            f'<span class="value">{with_unit(error, unit)}<em>{falls}</em></span></div>'
        )
        before = error
    return f'<div class="fall">{"".join(rows)}<div class="noise">noise {noise.describe(unit)}</div></div>'


class Parameters:
    """Sliders and intervals of parameters, and whether they are held or bounded."""

    def __init__(
        self, state: WorkbenchState, choose: Choose, on_slider_moved: Callable[[str, float], Awaitable[None]]
    ) -> None:
        self._state, self._choose, self._on_slider_moved = state, choose, on_slider_moved
        self._shown: DisplayedFit | None = None
        self._estimates: dict[str, ParameterEstimate] = {}  # intervals of the shown fit, once known
        self._listed: ModelSelection | None = None  # selection whose parameters have rows
        self._values: dict[str, float] = {}
        self._intervals: dict[str, ui.label] = {}
        self._numbers: dict[str, ui.label] = {}
        self._sliders: dict[str, ui.slider] = {}

    def build(self) -> None:
        """Create the elements."""
        with ui.element("section").classes("card sliders"):
            with ui.row().classes("bar"):
                heading("Parameters", elements.SLIDER)
                ui.space()
                self._back = ui.button(
                    "back to the fit", on_click=lambda: self._choose(self._state.choice.fitted)
                )
                set_props(self._back.props("flat dense no-caps"), title=elements.BACK)
                self._back.set_visibility(False)
            self._list = ui.element("div").classes("parameters")

    def show(self, shown: DisplayedFit) -> None:
        """List the parameters of a fit; unknown intervals follow later."""
        if self._shown is None or shown.fitted is not self._shown.fitted:
            self._estimates = {}
        self._shown, self._values = shown, shown.values
        self._back.set_visibility(bool(shown.choice.slider_values))
        if shown.choice.fitted == self._listed:
            for name, value in self._values.items():
                self._mark_state(name)
                self._sliders[name].set_value(value)
            return
        self._listed = shown.choice.fitted
        self._list.clear()
        self._intervals, self._numbers, self._sliders = {}, {}, {}
        with self._list:
            for name in self._values:
                self._row(name)
            if not self._values:
                ui.label("nothing is fitted in this model").classes("quiet")

    def show_intervals(self, estimates: Mapping[str, ParameterEstimate]) -> None:
        """Show the 95 % intervals.

        Args:
            estimates: estimates by "effect.parameter".
        """
        assert self._shown is not None  # noqa: S101, set by `show`
        self._estimates = dict(estimates)
        self._values = {name: p.value for name, p in estimates.items()}
        self._values |= self._shown.choice.slider_values
        for name in self._numbers:
            self._mark_state(name)

    def mark_slider_values(self, shown: DisplayedFit) -> None:
        """Show the values of moved sliders."""
        self._shown = shown
        self._values |= shown.choice.slider_values
        self._back.set_visibility(True)
        for name in shown.choice.slider_values:
            self._mark_state(name)

    def _mark_state(self, name: str) -> None:
        """Write a parameter's value and 95 % interval, and the fitted value beside a moved slider."""
        assert self._shown is not None  # noqa: S101, set by `show`
        fitted, choice = self._shown.fitted, self._shown.choice
        unit = {**fitted.model.gains, **fitted.model.inner}[name].unit_of(fitted.data)
        estimate = self._estimates.get(name)
        number = value = rounded(fitted.values[name], 4)
        text = "± …"
        if estimate is not None:
            value, text = with_interval(estimate)
            number = value
        if name in choice.slider_values:
            half = None if estimate is None or estimate.at_bound else estimate.half_interval
            number = significant(self._values[name], half)
            text = f"held at {value}" if name in choice.held else f"fit: {value} {text}"
        elif name in choice.held:
            text = "held"
        elif name in choice.bounds:
            low, high = choice.bounds[name]
            at_bound = fitted.values[name] in choice.bounds[name]
            text = f"within {low:.3g} to {high:.3g}, {'held at this bound' if at_bound else text}"
        self._numbers[name].set_text(text_with_unit(number, unit))
        self._intervals[name].set_text(text)

    def _row(self, name: str) -> None:
        assert self._shown is not None  # noqa: S101, set by `show`
        value = self._values[name]
        effect, _, parameter = name.partition(".")
        with set_props(ui.element("div").classes("parameter"), data_parameter=name):
            ui.html(f"{escape(effect.replace('_', ' '))} <b>{escape(parameter)}</b>").classes("name")
            self._numbers[name] = ui.label().classes("value")
            self._intervals[name] = set_props(ui.label().classes("interval"), title=elements.INTERVAL)
            self._mark_state(name)
            # from minus to plus twice the value, within the physical bounds
            fitted, known = self._shown.fitted.values[name], self._state.parameter(name)
            reach = 2.0 * abs(fitted) or (known.typical[1] - known.typical[0])
            low, high = max(fitted - reach, known.lower), min(fitted + reach, known.upper)
            slider = ui.slider(min=low, max=high, step=(high - low) / _STEPS, value=value).props("dense")
            set_props(slider, aria_label=name, title=elements.SLIDER)

            async def move_slider(event: events.GenericEventArguments) -> None:
                await self._on_slider_moved(name, float(event.args))

            async def release(event: events.GenericEventArguments) -> None:
                await move_slider(event)
                self._state.release()  # completes one undo step

            async def hold() -> None:
                value = None if name in self._state.choice.held else self._values[name]
                await self._choose(self._state.with_held(name, value))

            slider.on("update:model-value", move_slider, throttle=0.05).on("change", release)
            self._sliders[name] = slider
            is_held = name in self._state.choice.held
            lock = ui.button(icon="lock" if is_held else "lock_open", on_click=hold)
            set_props(lock.props("flat dense size=sm"), title=elements.HOLD, aria_label=f"hold {name}")
            arrows = ui.button(icon="unfold_more", on_click=lambda: self._ask_bounds(name, low, high))
            set_props(arrows.props("flat dense size=sm"), title=elements.BOUND, aria_label=f"bound {name}")

    def _ask_bounds(self, name: str, low: float, high: float) -> None:
        with self._list, ui.dialog() as dialog, ui.card().classes("bounds"):
            ui.label(f"Bounds of {name}").classes("text-bold")
            low, high = self._state.choice.bounds.get(name, (float(f"{low:.4g}"), float(f"{high:.4g}")))
            lower = ui.number("at least", value=low).props("dense outlined")
            upper = ui.number("at most", value=high).props("dense outlined")

            async def bound() -> None:
                with errors_as_warnings():
                    pair = [math.nan if bound.value is None else bound.value for bound in (lower, upper)]
                    choice = self._state.with_bounds(name, (pair[0], pair[1]))
                    dialog.close()
                    await self._choose(choice)

            async def free() -> None:
                dialog.close()
                await self._choose(self._state.with_held(name, None))

            with ui.row():
                ui.button("Apply", on_click=bound).props("dense unelevated no-caps")
                ui.button("Remove", on_click=free).props("dense flat no-caps")
        dialog.on("hide", dialog.delete)
        dialog.open()
