"""Write a diagnosis in sentences, and draw its error budget as an SVG picture, for every medium."""

from collections.abc import Sequence
from html import escape
from math import nan

from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.forms import SLOW, Form
from palpate.estimation.diagnosis.residual_checks import RARE_EVENTS
from palpate.estimation.diagnosis.result import NoiseFloor, RemainingError
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import rounded, with_unit
from palpate.estimation.estimate_channel import UNPHYSICAL
from palpate.estimation.fit.measurement_noise import describe_noise
from palpate.estimation.kinds import Kind
from palpate.render import palette
from palpate.render.view import NOISE, RANGE, BudgetPart, BudgetView, VerdictView, percent

_NO_FALL = 0.98  # ratio to the previous error above which the error counts as unchanged


def _join_names(names: Sequence[str], last: str = "and") -> str:
    """Join names with commas, and with a word before the last."""
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def diagnosis_verdict(diagnosis: ChannelDiagnosis) -> VerdictView:
    """Make the view of a diagnosis's verdict."""
    names = tuple(entry.effect for entry in diagnosis.accepted)
    has_reason = diagnosis.complete and "; " in diagnosis.reason
    is_explained = diagnosis.verdict is not Verdict.UNEXPLAINED
    remarks = [] if is_explained and not has_reason else [f"Why: {_with_period(diagnosis.reason)}"]
    if differs := diagnosis.differs_between_runs:
        remarks.append(f"A different value of {differs} in each run explains the differences between runs.")
    remarks += [f"Caution: {_with_period(text)}" for text in diagnosis.cautions]
    if diagnosis.no_experiment:
        remarks.append(_with_period(diagnosis.no_experiment[0].upper() + diagnosis.no_experiment[1:]))
    return VerdictView(str(diagnosis.verdict), _sentence(diagnosis), tuple(remarks), names)


def _sentence(diagnosis: ChannelDiagnosis) -> str:
    if diagnosis.verdict is Verdict.INSUFFICIENT:
        following = diagnosis.next_experiment  # its instruction may repeat the end of the reason
        cause = diagnosis.reason.removesuffix(f"; {following.instruction}" if following else "")
        return f"{diagnosis.channel}: no verdict is possible: {_with_period(cause)}"
    error = _error_sentence(diagnosis)
    unknown_forms = (entry for entry in diagnosis.budget if entry.form is Form.UNKNOWN)
    kinds = [f"{entry.kind.word} ({percent(entry.share)})" for entry in unknown_forms]
    if diagnosis.verdict is Verdict.ADEQUATE:
        unrelated = _unrelated_error(diagnosis)
        return f"{diagnosis.channel}: these data show no missing effect. {error}{unrelated}"
    if not diagnosis.accepted and kinds:
        return (
            f"{diagnosis.channel}: the kind of the missing effect is known, but not its form: "
            f"{_join_names(kinds)}. {error}"
        )
    if not diagnosis.accepted:
        return (
            f"{diagnosis.channel}: something is missing that no known effect explains; it "
            f"{_dependence(diagnosis.depends_on) or 'depends on no single signal'}. {error}"
        )
    names = []
    # With its approximate form and alternatives; one alternative may replace two effects.
    for entry in diagnosis.accepted:
        parts = {name: EFFECTS[name].parts if name in EFFECTS else () for name in entry.confused_with}
        rivals = [f"{name} for both" if entry.effect in parts[name] else name for name in parts]
        remarks = ["approximate"] if entry.form is Form.APPROXIMATE else []
        remarks += [f"or {_join_names(rivals, 'or')}"] if rivals else []
        names.append(f"{entry.effect} ({'; '.join(remarks)})" if remarks else entry.effect)
    verb = "is" if len(diagnosis.accepted) == 1 else "are"
    missing = f"{diagnosis.channel}: {_join_names(names)} {verb} missing from the base model. {error}"
    if diagnosis.complete is not False or diagnosis.remaining is None:
        return f"{missing}{_unrelated_error(diagnosis)}"
    unknown = f" The form of {_join_names(kinds)} is not known." if kinds else ""
    return f"{missing}{_unexplained_error(diagnosis.remaining, diagnosis.floor)}{unknown}"


def _unexplained_error(left: RemainingError, floor: NoiseFloor | None) -> str:
    """State the error that an incomplete model leaves, and the signals on which it depends."""
    dependence = _dependence(left.depends_on)
    if floor is not None and floor.at_most and left.times_floor <= 1.0:
        return f" The remaining error may be noise{', but ' * bool(dependence)}{dependence}."
    bound = "at least " if floor is not None and floor.at_most else ""
    size = f" of {bound}{rounded(left.times_floor, 2)} times the noise" if left.times_floor >= NOISE else ""
    return f" An unexplained error{size} remains{' and ' * bool(dependence)}{dependence}."


def _dependence(signals: Sequence[str]) -> str:
    """State on which signals an error depends, or that few samples hold it; empty if nothing is known."""
    if RARE_EVENTS in signals:
        return "comes from a few samples, as with impacts, a breakaway or lost readings"
    return f"depends on {_join_names(signals)}" if signals else ""


def _unrelated_error(diagnosis: ChannelDiagnosis) -> str:
    """State that an error well above the noise depends on no signal; empty if there is none."""
    left, floor = diagnosis.remaining, diagnosis.floor
    if left is None or floor is None or floor.at_most or left.times_floor <= SLOW:
        return ""
    times = rounded(left.times_floor, 2)
    return f" The remaining error, {times} times the noise, depends on no recorded signal."


def _error_sentence(diagnosis: ChannelDiagnosis) -> str:
    unit, before, after = diagnosis.effort_unit, diagnosis.baseline, diagnosis.final
    if before is None or after is None:
        return ""
    noise = ""
    if diagnosis.noise_floor is not None and diagnosis.floor is not None:
        floor, size = diagnosis.floor, with_unit(diagnosis.noise_floor, unit)
        noise = f" (noise {describe_noise(size, floor.source, at_most=floor.at_most, motion=floor.motion)})"
    if not diagnosis.accepted:
        return f"The error in held-out runs is {with_unit(after.rmse, unit)}{noise}."
    added = "it" if len(diagnosis.accepted) == 1 else "them"
    if after.rmse > _NO_FALL * before.rmse:
        stays = f"With {added}, the error in held-out runs stays at {with_unit(after.rmse, unit)}"
        means, before_means = after.rmse_of_means, before.rmse_of_means
        if means is None or before_means is None or means > _NO_FALL * before_means:
            return f"{stays}{noise}."
        return (
            f"{stays} for single samples{noise}. Averaged over {after.samples_per_mean} samples "
            f"(the resolution of the velocity), it falls from {rounded(before_means)} "
            f"to {with_unit(means, unit)}."
        )
    fall = f"from {rounded(before.rmse)} to {with_unit(after.rmse, unit)}"
    return f"With {added}, the error in held-out runs falls {fall}{noise}."


def _with_period(reason: str) -> str:
    """Write a reason as a sentence with one punctuation mark at its end."""
    return reason if reason.endswith(("?", ".")) else f"{reason}."


def unphysical_remarks(unphysical: Sequence[str]) -> tuple[str, ...]:
    """Report physically impossible parameters in one sentence; empty if there are none.

    Args:
        unphysical: descriptions of parameters outside their physical bounds.
    """
    return (f"{_join_names(unphysical)}: {UNPHYSICAL}.",) if unphysical else ()


def describe_error_decrease(
    channel: str, errors: Sequence[float], added: Sequence[str], noise: float, unit: str, *, is_bound: bool
) -> str:
    """Describe in one or two sentences how added effects changed the error.

    Args:
        channel: name of the channel.
        errors: errors of each stage, the base model's first.
        added: added effects, one fewer than errors.
        noise: error of a complete model.
        unit: unit of the errors.
        is_bound: whether the noise may be smaller.
    """
    first, last = errors[0], errors[-1]
    subject = f"{channel} with {_join_names(added)}: the error in held-out runs"
    if last > _NO_FALL * first:
        return f"{subject} does not fall ({rounded(first)} before, {with_unit(last, unit)} now)."
    times = last / noise if noise > 0.0 else float("inf")
    ends = f"to {'at least ' * is_bound}{times:.1f} times the noise"
    if times < NOISE:
        ends = "which may be noise" if is_bound else "down to the noise"
    falls = f"{subject} falls from {rounded(first)} to {with_unit(last, unit)}, {ends}."
    before = errors[-2]
    if last <= _NO_FALL * before:
        return falls
    does = "increases the error" if last * _NO_FALL > before else "hardly reduces the error"
    step = f"from {rounded(before, 4)} to {with_unit(last, unit, 4)}"
    return f"{falls} The last step, {added[-1]}, {does}: {step}."


_SHOWN = 0.005  # share below which unexplained error is not mentioned


def budget_view(diagnosis: ChannelDiagnosis) -> BudgetView | None:
    """Make the view of a channel's error budget; None if the diagnosis has none."""
    if diagnosis.rest is None or diagnosis.baseline is None:
        return None
    kinds = [
        BudgetPart(
            word=entry.kind.word,
            share=entry.share,
            color=palette.KINDS[entry.kind],
            interval=entry.interval,
            necessary=entry.necessary,
            sufficient=entry.sufficient,
            form=entry.form.value,
            effects=tuple(entry.effects),
        )
        for entry in diagnosis.budget
    ]
    confusions, pairs = list[str](), set[frozenset[Kind]]()
    for entry in diagnosis.budget:  # indistinguishable kinds, each pair once
        if entry.replaceable_by and (pair := frozenset({entry.kind, *entry.replaceable_by})) not in pairs:
            pairs.add(pair)
            alternatives = " or ".join(kind.word for kind in entry.replaceable_by)
            confusions.append(
                f"These data cannot tell {entry.kind.word} from {alternatives}. To separate "
                f"{entry.kind.word} from {entry.replaceable_by[0].word}: {entry.experiment}."
            )
    is_bound = diagnosis.floor is None or diagnosis.floor.at_most
    at_most, at_least = ("at most", "at least") if is_bound else ("", "")
    parts = [*kinds, BudgetPart("noise", diagnosis.rest.noise, palette.NOISE, at_most)]
    if diagnosis.rest.unexplained >= _SHOWN:
        parts.append(BudgetPart("unexplained", diagnosis.rest.unexplained, palette.UNEXPLAINED, at_least))
    error = with_unit(diagnosis.baseline.rmse, diagnosis.effort_unit)
    shares = ", ".join(f"{part.word} {part.share_text}" for part in parts)
    sentence = f"Of the {error} error: {shares}." if kinds or len(parts) > 1 else ""
    if not sentence and diagnosis.verdict is Verdict.UNEXPLAINED:
        sentence = f"No kind of effect accounts for the error of {error}."
    elif not sentence:
        left = diagnosis.remaining
        exceeds_noise = left is not None and left.times_floor > NOISE
        within = "depends on no recorded signal" if exceeds_noise else "is within the noise"
        what = "may be noise" if is_bound else within
        sentence = f"The whole error of {error} {what}."
    return BudgetView(sentence, tuple(parts), tuple(confusions))


_BAR, _ROW, _TOP = 28, 22, 50  # heights of the stacked bar and of a row, and where the rows begin [px]
_SECOND = 16  # height of a row's second line where the picture is narrow [px]
_NARROW = 640  # [px]
_TRACK = "rgba(128,140,155,0.25)"
_LABELED = 0.06  # share of the bar's width, from which a segment has its percentage in it
_CHARACTER = 6.4  # width of a letter on average [px]


def budget_svg(budget: BudgetView, width: int, ink: str = "currentColor") -> str:
    """Draw a stacked bar of all parts, and below it one row per part with its range.

    Args:
        budget: error budget to draw.
        width: width of the picture [px]; a narrow one has effects below their kind.
        ink: text color; by default the page's own, for a picture file a medium gray.

    Returns:
        One `svg` element, all texts escaped.
    """
    is_narrow = width < _NARROW
    heights = [_ROW + _SECOND * (is_narrow and bool(part.form)) for part in budget.parts]
    height = _TOP + sum(heights) + 4
    # the stacked bar; the shares fill it
    total = sum(max(part.share, 0.0) for part in budget.parts) or 1.0
    drawn, left = list[str](), 0.0
    for part in budget.parts:
        share = max(part.share, 0.0) / total
        low, high = part.interval or (nan, nan)
        interval = f" (95 % interval {100 * low:.0f} to {100 * high:.0f} %)" if part.interval else ""
        words = escape(f"{part.word} {part.share_text}{interval}")
        drawn.append(
            f'<rect x="{left:.1f}" y="0" width="{share * width:.1f}" height="{_BAR}" fill="{part.color}">'
            f"<title>{words}</title></rect>"
        )
        if share > _LABELED:
            middle = left + share * width / 2
            drawn.append(
                _text(middle, 19, f"{100 * part.share:.0f} %", "#fff", size=12, anchor="middle", bold=True)
            )
        left += share * width
    names = 176  # width of the kinds' names
    track = (names + 92, width - 4) if is_narrow else (names + 92, names + 272)
    place, anchor = (track[1], "end") if is_narrow else (track[0], "start")
    drawn.append(_text(place, _TOP - 8, RANGE, ink, 11, anchor, 0.7))
    y = float(_TOP)
    for part, own in zip(budget.parts, heights, strict=True):
        base, left, right = y + 15, *track
        drawn += [
            f'<rect x="0" y="{y + 4:.1f}" width="12" height="12" rx="2" fill="{part.color}"/>',
            _text(20, base, part.word, ink),
            _text(left - 12, base, part.share_text, ink, anchor="end", bold=True),
        ]
        if part.range is not None:
            low, high, share = (
                left + (right - left) * min(max(value, 0.0), 1.0) for value in (*part.range, part.share)
            )
            drawn += [
                f'<rect x="{left}" y="{y + 9:.1f}" width="{right - left}" height="2" fill="{_TRACK}"/>',
                f'<rect x="{low:.1f}" y="{y + 7:.1f}" width="{max(high - low, 2.0):.1f}" height="6" rx="2" '
                f'fill="{part.color}" opacity="0.55"><title>{escape(part.range_text)}</title></rect>',
                f'<circle cx="{share:.1f}" cy="{y + 10:.1f}" r="4.5" fill="{part.color}"/>',
            ]
        closest = ", closest" if part.form == "unknown" and part.effects else ""
        form = f"{part.form} form{closest}" if part.form else ""
        words = ": ".join(filter(None, [form, ", ".join(part.effects)]))
        x, room = (20, width - 20) if is_narrow else (right + 16, width - right - 16)
        most = int(room / _CHARACTER)
        cut = words if len(words) <= most else f"{words[: most - 1]}…"
        title = f"<title>{escape(words)}</title>" if cut != words else ""
        drawn.append(_text(x, base + _SECOND * is_narrow, cut, ink, size=12, opacity=0.75, title=title))
        y += own
    label = escape(budget.sentence, quote=True)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" role="img" '
        f'viewBox="0 0 {width} {height}" aria-label="{label}" font-family="{palette.FONT}" font-size="13">'
        f"{''.join(drawn)}</svg>"
    )


def _text(  # noqa: PLR0917, a text needs all of these
    x: float,
    y: float,
    words: str,
    ink: str,
    size: int = 13,
    anchor: str = "start",
    opacity: float = 1.0,
    *,
    bold: bool = False,
    title: str = "",
) -> str:
    weight = ' font-weight="600"' if bold else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{ink}" font-size="{size}" text-anchor="{anchor}" '
        f'opacity="{opacity:g}"{weight}>{title}{escape(words)}</text>'
    )
