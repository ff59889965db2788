"""The error budget of a diagnosis: its parts, and the sentence that says them."""

from collections.abc import Iterator

from estimation.diagnosis import ChannelDiagnosis
from estimation.kinds import Kind
from palpate.render import palette
from palpate.render.view import BudgetPart, BudgetView

_SHOWN = 0.005  # share below which what nothing explains is not mentioned


def budget_view(found: ChannelDiagnosis) -> BudgetView | None:
    """Arrange the error budget of a channel for display; None where the diagnosis has none."""
    if found.rest is None or found.baseline is None:
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
        for entry in found.budget
    ]
    is_bound = found.floor is None or found.floor.at_most
    at_most, at_least = ("at most", "at least") if is_bound else ("", "")
    parts = [*kinds, BudgetPart("noise", found.rest.noise, palette.FLOOR, at_most)]
    if found.rest.unexplained >= _SHOWN:
        parts.append(BudgetPart("unexplained", found.rest.unexplained, palette.UNEXPLAINED, at_least))
    error = f"{found.baseline.rmse:.3g} {found.effort_unit}"
    shares = ", ".join(f"{part.word} {part.share_text}" for part in parts)
    sentence = f"Of the {error} error: {shares}." if kinds or len(parts) > 1 else ""
    return BudgetView(
        sentence or f"All of the {error} error passes for noise.", tuple(parts), tuple(_confusions(found))
    )


def _confusions(found: ChannelDiagnosis) -> Iterator[str]:
    """Kinds that cannot be told apart, each pair once."""
    pairs: set[frozenset[Kind]] = set()
    for entry in found.budget:
        if entry.replaceable_by and (pair := frozenset({entry.kind, *entry.replaceable_by})) not in pairs:
            pairs.add(pair)
            others = " or ".join(kind.word for kind in entry.replaceable_by)
            yield (
                f"This data cannot tell {entry.kind.word} from {others}. To separate "
                f"{entry.kind.word} from {entry.replaceable_by[0].word}: {entry.experiment}."
            )
