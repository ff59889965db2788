"""The view of a study, from which terminal, report and recording draw."""

from collections.abc import Sequence

from estimation.study import ChannelResult, Stage, Study
from palpate.render.build import channel_view, stage_view
from palpate.render.view import ChannelView, StageView, StudyView
from palpate.words import count


def view_of(
    study: Study, results: Sequence[ChannelResult] | None = None, commands: Sequence[str] = ()
) -> StudyView:
    """All that is known of a study.

    Args:
        study: what was measured.
        results: what to show of it; None for all.
        commands: that lead to the same.
    """
    shown = study.results() if results is None else results
    source = study.source
    warnings = (f"{name}: {one}" for name, several in study.warnings.items() for one in several)
    notes = (*([f"read: {source.read}"] if source.read else []), *source.notes, *warnings)
    return StudyView(
        source.name, tuple(map(result_view, shown)), _facts(study, shown), tuple(commands), notes
    )


def result_view(result: ChannelResult) -> ChannelView:
    """All that is known of one channel."""
    compared, diagnosis = result.shown, result.diagnosis
    is_said = diagnosis is not None and diagnosis.reason in result.reason
    return channel_view(
        result.channel.data,
        [_stage(stage, result.stages[: place + 1]) for place, stage in enumerate(result.stages)],
        result.noise,
        parts=compared.parts if compared is not None else None,
        words=compared.words[1:] if compared is not None else (),
        diagnosis=diagnosis,
        not_judged=compared.not_judged if compared is not None else "",
        notes=(result.reason,) if result.reason and not is_said else (),
    )


def _stage(stage: Stage, so_far: Sequence[Stage]) -> StageView:
    one = stage.fitted
    label = f"+ {stage.added}" if stage.added else one.model.name
    name = " + ".join([one.model.name, *(before.added for before in so_far if before.added)])
    return stage_view(
        one.model,
        one.parameters,
        one.predicted,
        one.residual,
        rmse=one.rmse,
        label=label,
        name=name,
        number=stage.number,
        unphysical=one.unphysical,
    )


def _facts(study: Study, results: Sequence[ChannelResult]) -> dict[str, str]:
    channels = [one.channel for one in results]
    facts = {
        "channels": ", ".join(one.name for one in channels),
        "data": f"{count(len(channels[0].data.runs), 'run')}, {count(len(channels[0].data), 'sample')}",
        "base model": ", ".join(dict.fromkeys(one.model.name for one in channels)),
        "SHA-256": ", ".join(f"{one.name} {one.sha256[:12]}" for one in channels),
    }
    if study.source.session is not None:
        metadata = study.source.session.metadata
        facts |= {"recorded": metadata.created_utc, "by": metadata.command_line}
    return {name: value for name, value in facts.items() if value}
