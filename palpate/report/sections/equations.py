"""The final model written out, each term with its physics and source."""

import re
from html import escape
from typing import ClassVar

from estimation.effect import AdditiveEffect, Effect, MotionEffect
from estimation.model import Model
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section

_BREAK = re.compile(r"[,;] (?![^(]*\))")  # between a term and its conditions, not within parentheses
GREEK = {"tau": "τ", "mu": "μ", "pi": "π"}


class EquationsSection(Section):
    """The final model's equations."""

    name: ClassVar[str] = "equations"
    title: ClassVar[str] = "The final model"
    place: ClassVar[int] = 60

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(
            pieces.channel_heading(report, story) + _model(story.stages[-1].model)
            for story in report.stories
            if story.stages
        )


def _model(model: Model) -> str:
    rows = [
        [escape(effect.name), typeset(effect.equation), escape(effect.physics), escape(effect.source)]
        for effect in model.effects
    ]
    table = pieces.table(["effect", "equation", "physics", "source"], rows)
    return f"<div class='equation'>{written_out(model)}</div>{table}"


def written_out(model: Model) -> str:
    """The whole model in one line of HTML: what adds up, on which motion, seen through which sensor."""
    terms = [effect for effect in model.effects if isinstance(effect, AdditiveEffect)]
    left = next((_sides(effect)[0] for effect in terms), "effort")
    total = " + ".join(f"<span class='term'>{typeset(_first_part(effect))}</span>" for effect in terms)
    moved = [effect for effect in model.effects if isinstance(effect, MotionEffect)]
    sensed = [effect for effect in model.effects if not isinstance(effect, AdditiveEffect | MotionEffect)]
    where = "".join(f"<br>with {typeset(rest)}" for effect in terms if (rest := _condition(effect)))
    where += "".join(f"<br>on the motion {typeset(effect.equation)}" for effect in moved)
    read = "".join(f"<br>seen as {typeset(effect.equation)}" for effect in sensed)
    return f"<i>{escape(left)}</i> = {total}{where}{read}"


def typeset(equation: str) -> str:
    """Powers raised, numbers of symbols lowered, Greek letters as such, everything escaped."""
    raised = re.sub(r"\^(\([^)]*\)|[\w.]+)", r"<sup>\1</sup>", escape(equation, quote=False))
    lowered = re.sub(r"\b([A-Za-z])(\d)\b", r"\1<sub>\2</sub>", raised)
    return re.sub(r"\b(tau|mu|pi)\b", lambda found: GREEK[found[1]], lowered)


def _sides(effect: Effect) -> tuple[str, str]:
    left, _, right = effect.equation.partition("=")
    return left.strip(), right.strip()


def _first_part(effect: Effect) -> str:
    """A term without its left side and its conditions; a reading's "effort + b" adds only b."""
    return re.sub(r"^effort \+ ", "", _BREAK.split(_sides(effect)[1])[0])


def _condition(effect: Effect) -> str:
    """What an equation says after its term."""
    return "".join(_BREAK.split(_sides(effect)[1], maxsplit=1)[1:])
