"""Says what is missing in a model, with evidence; or that nothing is, or that nobody has named it."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis.answer import answer, insufficient
from estimation.diagnosis.each import Each, one_by_one
from estimation.diagnosis.judgement.below_a_step import below_a_step
from estimation.diagnosis.judgement.gate import refuse, usable
from estimation.diagnosis.judgement.objection import objection_to
from estimation.diagnosis.result import ChannelDiagnosis, Diagnosis
from estimation.diagnosis.robot import judge_robot
from estimation.diagnosis.search.chain import Chain, build
from estimation.diagnosis.search.library import library
from estimation.diagnosis.search.search import Progress, Search
from estimation.effect import Effect
from estimation.model import Model


def diagnose(
    data: ChannelData | Sequence[ChannelData],
    model: Model | Sequence[Model],
    effects: Iterable[Effect] | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    file: str = "",
    each: Each = one_by_one,
) -> Diagnosis:
    """Diagnose each channel; those of one robot then tell on each other, see `judge_robot`.

    Args:
        data: one channel or several.
        model: the base model of all, or one for each channel.
        effects: the library of hypotheses; by default all that palpate knows.
        rng: for surrogates.
        progress: told what is being done and which share of that is done.
        file: what the data came from, for the record.
        each: does the same work on several things, perhaps in several processes.

    Returns:
        One entry for each channel, in the order given.
    """
    channels = [data] if isinstance(data, ChannelData) else list(data)
    models = [model] * len(channels) if isinstance(model, Model) else list(model)
    known = library() if effects is None else tuple(effects)
    told = progress or (lambda what, share: None)

    def run(
        numbers: Sequence[int], made: Sequence[ChannelData], bases: Sequence[Model]
    ) -> list[ChannelDiagnosis]:
        pairs = zip(made, bases, strict=True)
        return [diagnose_channel(channel, base, known, rng, told, each=each) for channel, base in pairs]

    found = [one.found for one in judge_robot(channels, models, known, run)]
    return Diagnosis(file=file, model=models[0].name if models else "", channels=found)


def diagnose_channel(
    data: ChannelData,
    model: Model,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress,
    *,
    each: Each = one_by_one,
) -> ChannelDiagnosis:
    """Diagnose one channel; see `diagnose`."""
    good = usable(data)
    reason = refuse(data.select(good), model)
    if reason:
        return insufficient(data, reason)
    search = Search(data, model, good, effects, rng, progress, each)
    chain = build(search)
    objection = objection_to(chain.end, chain.floor, is_complete=chain.is_complete)
    if objection:
        chain = replace(chain, is_complete=False, dominant=None)
    reason = _too_coarse(search, chain)
    if reason is None:
        return answer(search, chain, objection)
    return insufficient(data, f"{reason}; besides, {objection.reason}" if objection else reason)


def _too_coarse(search: Search, chain: Chain) -> str | None:
    """Why what is left, and has no name, may be the reader's steps; what these do by themselves was tried."""
    tried = any(effect.name == "quantisation" for effect in search.effects)
    if chain.is_complete or chain.named or not tried:
        return None
    return below_a_step(chain.start)
