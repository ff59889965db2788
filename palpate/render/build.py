"""Build views of results, and write all files about a study from the same view."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from palpate.common import console
from palpate.common.console import count
from palpate.common.files import atomic_write_all
from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.import_rows import UNKNOWN_PHASE
from palpate.estimation.data_quality import list_warnings
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.effect import AdditiveEffect, MemoryEffect, MotionEffect, SensorEffect
from palpate.estimation.estimate import ParameterEstimate, with_unit
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import block_index, blocks, since_start
from palpate.estimation.study import ChannelResult, ModelStudy
from palpate.estimation.study.comparison import EXPLAINS_LITTLE, MAY_BE_NOISE, ROUNDING, Comparison
from palpate.render.diagnosis import (
    budget_view,
    describe_error_decrease,
    diagnosis_verdict,
    unphysical_remarks,
)
from palpate.render.view import (
    NOISE,
    AxisLabels,
    ChannelView,
    StageView,
    StudyView,
    VerdictView,
)
from palpate.robot_io.extras import missing_package
from palpate.robot_io.types import BoolArray, FloatArray

_GAP = 0.05  # gap between runs on the time axis, as a share of the mean run
_SAME_SPEED = 1.06  # ratio up to which speeds count as the same
_INWARD = (Phase.APPROACH, Phase.LOADING, UNKNOWN_PHASE)
_TERM = re.compile(r"[,;] (?![^(]*\))")  # separator between a term and its conditions, outside parentheses


def channel_view(
    data: ChannelData,
    stages: Sequence[StageView],
    noise: MeasurementNoise | None,
    *,
    compared: Comparison | None = None,
    diagnosis: ChannelDiagnosis | None = None,
    scored: BoolArray | None = None,
    notes: Sequence[str] = (),
) -> ChannelView:
    """Collect what is known about one channel.

    Args:
        data: the measurement, n samples.
        stages: stages of its model, the base model first; empty if the data cannot be judged.
        noise: error of a complete model; None if unknown.
        compared: comparison of the last stage with the measurement; None if there is none.
        diagnosis: diagnosis of the channel; None if there is none.
        scored: samples whose error counts (n,); by default those where the last stage has a residual.
        notes: further sentences.
    """
    scale, _ = display_unit(data)
    if scored is None:
        scored = np.isfinite(stages[-1].residual) if stages else np.ones(len(data), dtype=np.bool_)
    fall = [(stage.label, stage.rmse) for stage in stages]
    parameters = stages[-1].parameters if stages else ()
    if not stages and diagnosis is not None and diagnosis.baseline is not None:
        steps = ((f"+ {entry.effect}", entry.rmse_after) for entry in diagnosis.accepted)
        fall = [("base model", diagnosis.baseline.rmse), *steps]
    if not stages and diagnosis is not None and diagnosis.final is not None:
        values = diagnosis.final.parameters.items()
        parameters = tuple(_as_estimate(name, value) for name, value in values)
    if diagnosis is not None:
        shown = {parameter.name.rpartition(".")[0] for parameter in parameters}
        spreads = ((entry.effect, entry.parameters.get("spread")) for entry in diagnosis.accepted)
        parameters += tuple(_as_estimate(f"{n}.spread", v) for n, v in spreads if v and n in shown)
    if noise is not None and fall:
        noise = noise.below(min(error for _, error in fall))
    view = ChannelView(
        name=data.name,
        axes=axes_of(data),
        time_s=concatenated_times(data),
        position=scale * data.position,
        velocity=scale * data.velocity,
        effort=data.effort,
        run=data.run,
        engaged=data.engaged,
        scored=scored,
        speeds=_run_speeds(data),
        stages=tuple(stages),
        error_steps=tuple(fall),
        parameters=parameters,
        noise_level=noise.value if noise else 0.0,
        noise_is_bound=noise is not None and noise.is_bound,
        noise_text=noise.describe(data.effort_unit) if noise else "",
        verdict=VerdictView("", ""),
        parts=compared.parts if compared is not None else {},
    )
    verdict = _verdict(view, compared, diagnosis)
    share = 100.0 * (1.0 - float(np.mean(scored))) if len(scored) else 0.0
    exclusion_note = compared.exclusion_note if compared is not None else ""
    if not exclusion_note and share >= 0.05:
        exclusion_note = f"{share:.2g} % of the samples are excluded from scoring; the report shades them."
    verdict = replace(verdict, remarks=(*verdict.remarks, *notes, *filter(None, [exclusion_note])))
    view = replace(view, verdict=verdict)
    if diagnosis is None:
        return view
    view = replace(view, budget=budget_view(diagnosis), accepted=tuple(diagnosis.accepted))
    if diagnosis.verdict is Verdict.ADEQUATE:
        return view
    ranking = tuple(entry for entry in diagnosis.ranking if entry.score > 0.0)
    return replace(view, ranking=ranking, next_experiment=diagnosis.next_experiment)


def _as_estimate(name: str, saved: ParameterValue) -> ParameterEstimate:
    """Return a parameter of a saved diagnosis as an estimate; its uncertainty may be unknown."""
    std_err = float("nan") if saved.std_err is None else saved.std_err
    return ParameterEstimate(name, saved.unit, saved.value, std_err, saved.interval, saved.at_bound)


def display_unit(data: ChannelData) -> tuple[float, str]:
    """Return the factor and the unit in which positions are displayed: mm for lengths."""
    return (1e3, "mm") if data.position_unit == "m" else (1.0, data.position_unit)


def axes_of(data: ChannelData) -> AxisLabels:
    """Return the titles of a channel's axes, with the units of its display."""
    effort, (_, unit) = data.effort_unit, display_unit(data)
    titles = {
        ChannelKind.CONTACT: ("contact force", "depth", "velocity inwards"),
        ChannelKind.SERVO: ("goal error", "position", "velocity"),
        ChannelKind.PRISMATIC: ("force", "position", "velocity"),
        ChannelKind.REVOLUTE: ("torque", "position", "velocity"),
    }
    what, place, speed = titles[data.kind]
    return AxisLabels(f"{what} [{effort}]", effort, f"{place} [{unit}]", f"{speed} [{unit}/s]")


def concatenated_times(data: ChannelData) -> FloatArray:
    """Place all runs, each of which may start at zero, one after the other on one time axis, shape (n,) [s].

    Args:
        data: the channel, n samples.
    """
    own_s, (first, run) = since_start(data.time_s, data.run), block_index(data.run)
    lengths_s = np.maximum.reduceat(own_s, first)
    steps_s = lengths_s + (_GAP * np.mean(lengths_s) if len(first) else 0.0)
    return own_s + (np.cumsum(steps_s) - steps_s)[run]


def _run_speeds(data: ChannelData) -> dict[int, str]:
    """Describe each run's speed, the slowest first; empty if all runs have the same speed."""
    if data.kind is not ChannelKind.CONTACT:
        return {}
    scale, unit = display_unit(data)
    speeds = dict[int, float]()
    for rows in blocks(data.run):
        # Median over the distance: it leaves out acceleration, and slow motion while the force settles.
        velocity = data.velocity[rows]
        inward = np.sort(velocity[np.isin(data.phase[rows], _INWARD) & (velocity > 0.0)])
        if data.run[rows.start] >= 0:
            covered = np.cumsum(inward)  # proportional to the distance, for even sampling
            speed = inward[np.searchsorted(covered, covered[-1] / 2)] if len(inward) else 0.0
            speeds[int(data.run[rows.start])] = scale * float(speed)
    groups = list[list[tuple[int, float]]]()
    for run, speed in sorted(speeds.items(), key=lambda pair: pair[1]):
        if not groups or speed > _SAME_SPEED * groups[-1][0][1]:
            groups.append([])
        groups[-1].append((run, speed))
    means = [float(np.mean([speed for _, speed in group])) for group in groups]
    words = [f"{mean:.0f} {unit}/s" if mean >= 10 else f"{mean:.2g} {unit}/s" for mean in means]
    alike = len(groups) < 2
    return {} if alike else {run: word for word, group in zip(words, groups, strict=True) for run, _ in group}


def equation_of(model: Model) -> str:
    """Return the model's equation: one line each for the sum of effects, the motion and the sensor."""
    terms = [effect for effect in model.effects if isinstance(effect, AdditiveEffect)]
    sides = [effect.equation.partition("=") for effect in terms]
    parts = [_TERM.split(right.strip(), maxsplit=1) for _, _, right in sides]
    left = sides[0][0].strip() if sides else "effort"
    total = f"{left} = " + " + ".join(part[0].removeprefix("effort + ") for part in parts)
    moved = [f"on the motion {e.equation}" for e in model.effects if isinstance(e, MotionEffect)]
    faded = [f"springs fade as {e.equation}" for e in model.effects if isinstance(e, MemoryEffect)]
    sensed = [f"seen as {e.equation}" for e in model.effects if isinstance(e, SensorEffect)]
    given = (f"with {part[1]}" for part in parts if len(part) > 1)
    return "\n".join([total, *given, *moved, *faded, *sensed])


def _verdict(
    view: ChannelView, compared: Comparison | None, diagnosis: ChannelDiagnosis | None
) -> VerdictView:
    """Make the view of the diagnosis or of the last stage's comparison, including later added effects."""
    if diagnosis is None and not view.stages:
        return VerdictView("", f"{view.name}: nothing was fitted.")
    labels, errors = [stage.label for stage in view.stages], [stage.rmse for stage in view.stages]
    unit, changes = view.axes.effort_unit, [label.removeprefix("+ ") for label in labels[1:]]
    fall = list[str]()
    if changes:
        level, is_bound = view.noise_level, view.noise_is_bound
        fall.append(describe_error_decrease(view.name, errors, changes, level, unit, is_bound=is_bound))
    wrong = unphysical_remarks(view.stages[-1].unphysical) if view.stages else ()
    if diagnosis is None:
        model, times = " ".join(labels), view.times_noise(errors[-1])
        # whether no missing effect shows in the error; None if none could show
        complete = compared is not None and (None if compared.may_be_noise else compared.is_complete)
        fits = complete is not False and not wrong  # a model with impossible parameters never fits
        verb, at_least = "may fit" if complete is None else "fits", "at least " * view.noise_is_bound
        far = "" if times < NOISE else f"; the error is {at_least}{times:.1f} times the noise"
        if complete is None:
            far = f", {EXPLAINS_LITTLE}"
        elif complete and far:
            far = f"{far}, {MAY_BE_NOISE}" if view.noise_level > 0.0 else f"; the error is {ROUNDING}"
        text = (
            f"{model} {verb if fits else 'does not fit'} {view.name}: error {with_unit(errors[-1], unit)} in "
            f"held-out runs, noise {view.noise_text}{far}."
        )
        words = compared.words[1:] if compared is not None and not fits else ()
        remarks = (*wrong, *fall, *words)
        word = ("" if complete is None else "fits") if fits else "misses"
        return VerdictView(word, text, remarks, (view.name, model))
    verdict = diagnosis_verdict(diagnosis)
    as_found = changes == [entry.effect for entry in diagnosis.accepted]
    since = tuple(f"Added since: {sentence}" for sentence in fall if not as_found)
    return replace(verdict, remarks=(*wrong, *since, *verdict.remarks))


def view_of(
    study: ModelStudy, results: Sequence[ChannelResult] | None = None, commands: Sequence[str] = ()
) -> StudyView:
    """Make the view of a study.

    Args:
        study: study of the measurement.
        results: channels to show; None for all.
        commands: commands that repeat the results.
    """
    shown = study.results() if results is None else results
    source = study.source
    warnings = list_warnings(study.warnings.items())
    notes = (*study.reading, *warnings)
    channels = [result.channel for result in shown]
    facts = {
        "channels": ", ".join(channel.name for channel in channels),
        "data": f"{count(len(channels[0].data.runs), 'run')}, {count(len(channels[0].data), 'sample')}",
        "base model": ", ".join(dict.fromkeys(channel.model.name for channel in channels)),
        "SHA-256": ", ".join(f"{channel.name} {channel.sha256[:12]}" for channel in channels),
    }
    if source.session is not None:
        metadata = source.session.metadata
        facts |= {"recorded": metadata.created_utc, "by": metadata.command_line}
    facts = {name: value for name, value in facts.items() if value}
    return StudyView(source.name, tuple(map(result_view, shown)), facts, tuple(commands), notes)


def result_view(result: ChannelResult, *, with_parameters: bool = True) -> ChannelView:
    """Make the view of one channel.

    Args:
        result: fits, comparison and diagnosis of the channel.
        with_parameters: whether to compute the parameters of each stage; their intervals take long.
    """
    diagnosis = result.diagnosis
    is_said = diagnosis is not None and diagnosis.reason in result.reason
    stages, name = list[StageView](), ""
    for stage in result.stages:
        fitted = stage.fitted
        label = f"+ {stage.added}" if stage.added else fitted.model.name
        name = f"{name} {label}" if stage.added and name else f"{fitted.model.name}"
        stages.append(
            StageView(
                number=stage.number,
                label=label,
                name=name,
                rmse=fitted.rmse,
                predicted=fitted.predicted,
                residual=fitted.residual,
                parameters=tuple(fitted.parameters.values()) if with_parameters else (),
                effects=fitted.model.effects,
                equation=equation_of(fitted.model),
                unphysical=fitted.unphysical,
            )
        )
    return channel_view(
        result.channel.data,
        stages,
        result.noise,
        compared=result.shown,
        diagnosis=diagnosis,
        notes=(result.reason,) if result.reason and not is_said else (),
    )


REPORT = "report.html"
RECORDING = "revisions.rrd"
NAMES = (REPORT, RECORDING)  # files that `write_outcome` may write


# The first bytes of every page contain this mark, see base.html.
_HEAD, _MARK = 200, b'<meta name="generator" content="palpate '


def is_own_page(path: Path) -> bool:
    """Return whether a file is a page that palpate made.

    Args:
        path: path of the file; it need not exist.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _MARK in file.read(_HEAD)


def write_outcome(
    folder: Path,
    study: ModelStudy,
    results: Sequence[ChannelResult],
    commands: Sequence[str],
    texts: Mapping[str, str] | None = None,
) -> dict[str, Path]:
    """Write the report, and a recording of diagnosed or added effects; return paths by kind.

    All files appear together, or none of them.

    Args:
        folder: existing folder for the files.
        study: study with its measurements.
        results: results of its channels.
        commands: commands that repeat the results.
        texts: texts of further files, by name.

    Raises:
        InputError: a file cannot be written.
    """
    # imported here because plotting libraries are slow to import, which would delay the verdict
    from palpate.render.report import document  # noqa: PLC0415

    texts = {**(texts or {}), REPORT: document(view_of(study, results, commands))}
    grown = [result for result in results if result.added or (result.diagnosis and result.diagnosis.rest)]
    if grown and not find_spec("rerun"):
        console.stderr().print(
            f"without {RECORDING}: {missing_package('rerun')}", soft_wrap=True, markup=False
        )
        grown = []
    with atomic_write_all({folder / name: text for name, text in texts.items()}):
        if grown:
            from palpate.render.recording.revisions import record_rerun  # noqa: PLC0415, slow to import

            record_rerun(view_of(study, grown), folder / RECORDING)
    return {"report": folder / REPORT} | ({"recording": folder / RECORDING} if grown else {})
