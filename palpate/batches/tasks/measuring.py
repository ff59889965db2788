"""Work function of a batch: all rows of the table for one measurement."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.candidates import applicable_effects, screen_effects
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.study import StudyChannel
from palpate.estimation.study.other_models import far_better_model
from palpate.robot_io.errors import InputError
from palpate.study import Study, arm_from_urdf
from palpate.sweep.case import Row


def measure(files: Sequence[Path], parameters: Mapping[str, Any]) -> list[Row]:
    """Read and evaluate one measurement; return one row for each channel.

    Args:
        files: files of the measurement.
        parameters: `where`, and as `options` those of `palpate.batches.run.batch`.

    Raises:
        InputError: the files cannot be read, or the model does not describe them.
    """
    options, study = parameters["options"], _study_of(files, parameters)
    if options.get("suggest"):
        suggested = []  # base models that fit far better than the usual one
        for channel in study.channels:
            better = None
            with suppress(InputError):
                better = far_better_model(study, channel, study.comparison(channel))
            suggested.append({"channel": channel.name, "suggested": better[0] if better else ""})
        return suggested
    if "screen" in options:
        # Gain in logarithmic score on held-out runs of each candidate effect, per block; a candidate with
        # physically impossible parameters gets no positive gain.
        rows, screen = list[Row](), options["screen"]
        for channel in study.channels:
            if study.refusal(channel) or channel.name not in (screen["channels"] or [channel.name]):
                continue
            fit = study.fit(channel, screen["added"].get(channel.name, ())).training_fit
            effects = applicable_effects(channel.to_fit, fit.model, study.effects)
            for candidate in screen_effects(fit, effects):
                gain = 0.5 * float(np.log(fit.solution.held_out / candidate.held_out))
                row = {"channel": channel.name, "candidate": candidate.effect.name}
                rows.append(row | {"gain": gain if candidate.possible else min(gain, 0.0)})
        return rows or [{"channel": ""}]
    diagnosed: dict[str, ChannelDiagnosis] = {}
    if options["diagnose"]:
        diagnosed = {entry.channel: entry for entry in study.diagnose(plan=False).channels}
    return [_row(study, channel, diagnosed.get(channel.name), options["add"]) for channel in study.channels]


def _study_of(files: Sequence[Path], parameters: Mapping[str, Any]) -> Study:
    options = parameters["options"]
    data = files[0] if len(files) == 1 else list(files)
    arm = arm_from_urdf(Path(options["urdf"]), options["tip_frame"]) if options["urdf"] else None
    read = options["read"] | {"where": options["read"]["where"] | parameters["where"]}
    return Study(data, options["model"], arm=arm, effects=options["effects"], keep=False, **read)


def _row(study: Study, channel: StudyChannel, diagnosis: ChannelDiagnosis | None, add: Sequence[str]) -> Row:
    warnings = [*study.source.notes, *study.warnings.get(channel.name, ())]
    row: Row = {
        "channel": channel.name,
        "model": channel.model.name,
        "unit": channel.effort_unit,
        "samples": len(channel.measured),
        "runs": len(channel.measured.runs),
    }
    comparison = None
    try:
        comparison = study.comparison(channel)
    except InputError as error:  # the data cannot be judged
        row |= {"verdict": Verdict.INSUFFICIENT.value, "reason": str(error)}
    if comparison is not None:
        added = list[str]()
        for name in add:
            try:
                study.fit(channel, [*added, name])
                added.append(name)
            except InputError as error:  # such as an effect of joints on a contact
                warnings.append(f"without {name}: {error}")
        comparison = study.comparison(channel, added)
        row |= {
            "model": comparison.model,
            "rmse": comparison.rmse,
            "noise": comparison.noise.value,
            "times_noise": comparison.lack_of_fit,
            "fits": comparison.fits,
            "excluded_share": float(1.0 - np.mean(comparison.scored)),
        }
        row |= {f"budget {entry.kind.word}": entry.share for entry in comparison.kinds}
    final = diagnosis.final if diagnosis is not None and diagnosis.accepted and not add else None
    if final is not None:  # use one model: a missing effect changes the other parameters
        row |= _all_columns(final.parameters)
    elif comparison is not None:
        row |= _all_columns(comparison.parameters)
    if diagnosis is None:
        return row | {"warnings": "; ".join(warnings)}
    row |= {
        "verdict": diagnosis.verdict.value,
        "reason": diagnosis.reason,
        "effects": ", ".join(entry.effect for entry in diagnosis.accepted),
        "forms": ", ".join(entry.form.value for entry in diagnosis.accepted),
    }
    if diagnosis.final is not None:
        row["rmse_final"] = diagnosis.final.rmse
    row |= {f"budget {entry.kind.word}": entry.share for entry in diagnosis.budget or ()}
    if diagnosis.rest is not None:
        row |= {"budget noise": diagnosis.rest.noise, "budget unexplained": diagnosis.rest.unexplained}
    for accepted in diagnosis.accepted:
        named = {f"{accepted.effect}.{name}": value for name, value in accepted.parameters.items()}
        row |= _all_columns(named)
    return row | {"warnings": "; ".join(warnings)}


def _all_columns(parameters: Mapping[str, ParameterEstimate | ParameterValue]) -> Row:
    """Return each value and, if determined, its standard error and the ends of its 95 % interval."""
    row: Row = {}
    for name, parameter in parameters.items():
        row[f"{name} [{parameter.unit}]"] = float(parameter.value)
        if parameter.at_bound or parameter.std_err is None or not np.isfinite(parameter.std_err):
            continue
        low, high = parameter.interval
        row |= {f"{name} low [{parameter.unit}]": float(low), f"{name} high [{parameter.unit}]": float(high)}
        row[f"{name} std_err [{parameter.unit}]"] = float(parameter.std_err)
    return row


def write_measurement_report(files: Sequence[Path], parameters: Mapping[str, Any], path: Path) -> None:
    """Write the report of one measurement, with the diagnosis and the effects that the batch has.

    Args:
        files: files of the measurement.
        parameters: see `measure`.
        path: path of the HTML page.

    Raises:
        InputError: the files cannot be read, or the page cannot be written.
    """
    options, study = parameters["options"], _study_of(files, parameters)
    if options["diagnose"]:
        study.diagnose(plan=False)
    for channel in study.channels:
        for name in options["add"]:
            with suppress(InputError):  # does not apply to this channel; the table has a warning
                study.add(name, channel=channel.name)
    study.report(path)
