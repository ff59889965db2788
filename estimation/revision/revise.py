"""Adds effects to a model one by one and keeps each stage, so that one can see the error fall and go back."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from estimation.channel import ChannelData
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.diagnosis.judgement.objection import floor_unseen
from estimation.diagnosis.search.extend import extend
from estimation.diagnosis.search.library import library
from estimation.effect import Effect
from estimation.fit.held_out import held_out_residual, rmse
from estimation.fit.intervals import Value, final, values
from estimation.fit.standing import Standing, stand
from estimation.gate.gate import refuse, usable
from estimation.model import Model
from robot_io.errors import InputError
from robot_io.types import FloatArray


@dataclass(frozen=True)
class Revision:
    """One stage of a model.

    Attributes:
        number: 0 for the base model.
        added: effect that this stage added; empty for the base model.
        model: all effects of the stage.
        parameters: with standard errors, by "effect.parameter".
        predicted: effort that it expects, shape (n,).
        residual: effort less prediction from gains fitted to the other runs, shape (n,); NaN where left out.
        rmse: of that residual.
        noise_floor: error that a complete model would leave, judged from this stage.
        share_left: share of the error that a flexible regression could still explain.
    """

    number: int
    added: str
    model: Model
    parameters: dict[str, Value]
    predicted: FloatArray
    residual: FloatArray
    rmse: float
    noise_floor: float
    share_left: float


def revise(
    data: ChannelData, model: Model, names: Sequence[str], effects: Iterable[Effect] | None = None
) -> tuple[Revision, ...]:
    """Add effects in this order, refitting everything at each stage.

    Args:
        data: the channel.
        model: the base model.
        names: effects to add.
        effects: where they are found; by default all that palpate knows.

    Returns:
        The base model, and one revision for each effect.

    Raises:
        InputError: the channel cannot be judged, or an effect is unknown, there already, or does not apply.
    """
    stages = zip(["", *names], standings(data, model, names, effects), strict=True)
    return tuple(revision_of(number, *stage) for number, stage in enumerate(stages))


def standings(
    data: ChannelData, model: Model, names: Sequence[str], effects: Iterable[Effect] | None = None
) -> Iterator[Standing]:
    """The base model as it stands, and then with one effect more at a time; see `revise`.

    Raises:
        InputError: as for `revise`.
    """
    good = usable(data)
    reason = refuse(data.select(good), model)
    if reason:
        raise InputError(f"channel '{data.name}': {reason}")
    known = {effect.name: effect for effect in (library() if effects is None else effects)}
    standing = stand(data, model, {}, good)
    yield standing
    for name in names:
        standing = extend(data, standing, _applicable(standing, known, name), good)
        yield standing


def _applicable(standing: Standing, known: dict[str, Effect], name: str) -> Effect:
    if name not in known:
        raise InputError(f"no effect is called '{name}'. Valid: {', '.join(sorted(known))}")
    effect = known[name]
    if not effect.applies_to(standing.data):
        lacking = [signal for signal in effect.needs if signal not in standing.data.context]
        which = "this" if standing.data.kind in effect.channels else f"a {standing.data.kind.value}"
        why = f"needs {', '.join(lacking)}" if lacking else f"is not for {which} channel"
        raise InputError(f"effect '{name}' {why} (channel '{standing.data.name}')")
    return effect.suited_to(standing.data)


def revision_of(number: int, added: str, standing: Standing) -> Revision:
    """What is kept of a stage."""
    residual = held_out_residual(standing.plain.frame, standing.trial)
    bench, trial = final(standing)
    floor = noise_floor(standing)
    return Revision(
        number=number,
        added=added,
        model=trial.model,
        parameters=values(bench, trial),
        predicted=trial.model.predict(standing.data, trial.parameters),
        residual=residual,
        rmse=rmse(residual),
        noise_floor=min(floor.value, floor_unseen(standing, floor.value)),
        share_left=floor.share_left,
    )
