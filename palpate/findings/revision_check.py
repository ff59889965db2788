"""Whether a revision that was read, and may have been edited by hand, makes sense."""

from collections.abc import Iterator

from estimation.base_model import ModelContext
from estimation.effects import EFFECTS
from estimation.models import MODELS
from palpate.findings.kept_revision import KeptRevision
from robot_io.errors import InputError


def flaw(revision: KeptRevision, number: int) -> str | None:
    """What is wrong with a revision, in a few words; None if nothing is.

    Args:
        revision: as it was read.
        number: that its file has in its name.
    """
    return next(_flaws(revision, number), None)


def _flaws(revision: KeptRevision, number: int) -> Iterator[str]:
    if revision.number != number:
        yield f"its number is {revision.number}"
    if revision.parent is not None and not 0 <= revision.parent < number:
        yield f"its parent is {revision.parent}, which is no earlier revision"
    if revision.model not in MODELS:
        yield MODELS.unknown(revision.model)
        return
    effects = revision.effects
    if len(set(effects)) < len(effects) or revision.added != "".join(effects[-1:]):
        yield f"its effects are {', '.join(effects) or 'none'}, and it added '{revision.added}'"
    unknown = [name for name in effects if name not in EFFECTS]
    if len(unknown) > len(revision.user_effects):
        yield EFFECTS.unknown(unknown[-1])
    if len(unknown) < len(revision.user_effects):
        return  # one of the user's own stands in for another of the same name, with parameters of its own
    if lacking := sorted(_wanted(revision) - set(revision.parameters)):
        yield f"its parameter {lacking[0]} is missing"


def _wanted(revision: KeptRevision) -> set[str]:
    """Parameters that the base model and all effects have, "effect.parameter"."""
    names = {*revision.effects, *(name.partition(".")[0] for name in revision.parameters)}
    fixed = [EFFECTS[name] for name in names if name in EFFECTS]
    own = {
        f"{effect.name}.{parameter.name}" for effect in fixed for parameter in (*effect.gains, *effect.inner)
    }
    try:
        base = MODELS[revision.model]().build(ModelContext())
    except InputError:  # needs an arm, which says what parameters there are
        return own
    return own | {*base.gains, *base.inner}
