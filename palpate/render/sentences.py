"""Verdicts and falling errors in sentences, the same in every medium."""

from collections.abc import Iterator, Sequence

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.diagnosis.forms import Form
from estimation.diagnosis.result import Accepted
from estimation.effects import EFFECTS
from estimation.physical import UNPHYSICAL
from palpate.render.view import NOISE, VerdictView, percent

_NO_FALL = 0.98  # of the error before: less is no fall


def enumerated(names: Sequence[str], last: str = "and") -> str:
    """Names with commas, and a word before the last."""
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def diagnosed(diagnosis: ChannelDiagnosis) -> VerdictView:
    """The verdict of a diagnosis."""
    names = tuple(entry.effect for entry in diagnosis.accepted)
    return VerdictView(str(diagnosis.verdict), _sentence(diagnosis), tuple(_remarks(diagnosis)), names)


def _sentence(diagnosis: ChannelDiagnosis) -> str:
    if diagnosis.verdict is Verdict.INSUFFICIENT:
        return f"{diagnosis.channel}: this data cannot say: {_ended(diagnosis.reason)}"
    if diagnosis.verdict is Verdict.ADEQUATE:
        return f"{diagnosis.channel}: nothing is missing that this data can show. {_error(diagnosis)}"
    if not diagnosis.accepted and (kinds := _kinds_without_form(diagnosis)):
        return (
            f"{diagnosis.channel}: what kind is missing is known, its form is not: {enumerated(kinds)}. "
            f"{_error(diagnosis)}"
        )
    if not diagnosis.accepted:
        return (
            f"{diagnosis.channel}: something is missing that no known effect explains; it depends on "
            f"{enumerated(diagnosis.depends_on) or 'no single signal'}. {_error(diagnosis)}"
        )
    names = enumerated([_with_rivals(entry) for entry in diagnosis.accepted])
    verb = "is" if len(diagnosis.accepted) == 1 else "are"
    return (
        f"{diagnosis.channel}: {names} {verb} missing from the model. {_error(diagnosis)}{_rest(diagnosis)}"
    )


def _with_rivals(entry: Accepted) -> str:
    """An effect with what is to be known of its name: an approximate form, and rivals."""
    rivals = [_in_its_place(name, entry.effect) for name in entry.confused_with]
    remarks = ["approximate"] if entry.form is Form.APPROXIMATE else []
    remarks += [f"or {enumerated(rivals, 'or')}"] if rivals else []
    return f"{entry.effect} ({'; '.join(remarks)})" if remarks else entry.effect


def _kinds_without_form(diagnosis: ChannelDiagnosis) -> list[str]:
    """Kinds of which no effect has the form, with their shares of the error."""
    unknown = (entry for entry in diagnosis.budget if entry.form is Form.UNKNOWN)
    return [f"{entry.kind.word} ({percent(entry.share)})" for entry in unknown]


def _in_its_place(rival: str, effect: str) -> str:
    """A rival, and what it would replace beside the effect if that is only a part of it."""
    parts = EFFECTS[rival].parts if rival in EFFECTS else ()
    return f"{rival} for both" if effect in parts else rival


def _error(diagnosis: ChannelDiagnosis) -> str:
    unit, before, after = diagnosis.effort_unit, diagnosis.baseline, diagnosis.final
    if before is None or after is None:
        return ""
    floor = _noise(diagnosis)
    if not diagnosis.accepted:
        return f"The error in held-out runs is {after.rmse:.3g} {unit}{floor}."
    added = "it" if len(diagnosis.accepted) == 1 else "them"
    if after.rmse > _NO_FALL * before.rmse:
        return f"With {added}, the error in held-out runs stays at {after.rmse:.3g} {unit}{floor}."
    fall = f"from {before.rmse:.3g} to {after.rmse:.3g} {unit}"
    return f"With {added}, the error in held-out runs falls {fall}{floor}."


def _noise(diagnosis: ChannelDiagnosis) -> str:
    """The noise with its source, in parentheses; nothing where it is not known."""
    if diagnosis.noise_floor is None or diagnosis.floor is None:
        return ""
    size = f"{diagnosis.noise_floor:.3g} {diagnosis.effort_unit}"
    source = diagnosis.floor.source.value
    return (
        f" (noise at most {size}, by {source})"
        if diagnosis.floor.at_most
        else f" (noise {size}, from {source})"
    )


def _rest(diagnosis: ChannelDiagnosis) -> str:
    """What is left beside the established effects, and how large it is."""
    if diagnosis.complete is not False or diagnosis.remaining is None:
        return ""
    signals = diagnosis.remaining.depends_on
    on = f", depends on {enumerated(signals)}" if signals else ""
    times = diagnosis.remaining.times_floor
    size = f": {times:.2g} times the noise" if times >= NOISE else ""
    left = f" Something more is left{size}{on}."
    kinds = _kinds_without_form(diagnosis)
    return f"{left} Of {enumerated(kinds)}, the form is not known." if kinds else left


def _remarks(diagnosis: ChannelDiagnosis) -> Iterator[str]:
    if diagnosis.verdict is Verdict.UNEXPLAINED or (diagnosis.complete and "; " in diagnosis.reason):
        yield f"Why: {_ended(diagnosis.reason)}"


def _ended(reason: str) -> str:
    """A reason as a sentence, with one mark at its end: some end with a question."""
    return reason if reason.endswith(("?", ".")) else f"{reason}."


def compared(
    channel: str, model: str, error: str, times: float, noise: str, *, possible: bool = True
) -> VerdictView:
    """Whether a model fits, by its error in held-out runs beside the noise.

    One whose parameters are not `possible` fits nothing, however small its error.
    """
    word = "fits" if times < NOISE and possible else "misses"
    errors = f"{error} in held-out runs, noise {noise}"
    far = "" if times < NOISE else f"; the error is {times:.1f} times the noise"
    return VerdictView(word, f"{model} {word} {channel}: {errors}{far}.", (), (channel, model))


def impossible(unphysical: Sequence[str]) -> tuple[str, ...]:
    """That parameters, each in words, make no physical sense: one sentence, or none."""
    return (f"But {enumerated(unphysical)}: {UNPHYSICAL}.",) if unphysical else ()


def falling(channel: str, errors: Sequence[float], added: Sequence[str], floor: float, unit: str) -> str:
    """What added effects did to the error, in one or two sentences.

    Args:
        channel: its name.
        errors: of each stage, the base model's first.
        added: effects, one fewer.
        floor: error that a complete model would leave.
        unit: of the errors.
    """
    first, last = errors[0], errors[-1]
    whole = f"{channel} with {enumerated(added)}: the error in held-out runs"
    if last > _NO_FALL * first:
        return f"{whole} does not fall: from {first:.3g} to {last:.3g} {unit}."
    times = last / floor if floor > 0.0 else float("inf")
    ends = "down to the noise" if times < NOISE else f"to {times:.1f} times the noise"
    falls = f"{whole} falls from {first:.3g} to {last:.3g} {unit}, {ends}."
    before = errors[-2]
    if last <= _NO_FALL * before:
        return falls
    does = "makes it worse" if last * _NO_FALL > before else "does next to nothing"
    return f"{falls} The last step, {added[-1]}, {does}: from {before:.4g} to {last:.4g} {unit}."
