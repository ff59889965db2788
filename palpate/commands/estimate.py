"""`palpate estimate`: how stiff and how damped is it?"""

from typing import Annotated

import numpy as np
import typer

from estimation.channel import ChannelData
from estimation.estimators import ESTIMATORS
from estimation.models import MODELS
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    FreshOption,
    TipFrameOption,
    UnitOption,
    UrdfOption,
    WhereOption,
    given_arm,
    import_options,
)
from palpate.findings.estimation_run import (
    ALL,
    ChannelEstimates,
    Material,
    choose_estimators,
    estimate_with,
    load_material,
)
from palpate.findings.subject import to_estimate
from palpate.render.estimates import as_data, calibration_remark, print_estimates
from palpate.words import count, safe, shown, typed
from robot_io.errors import InputError


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    model: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(MODELS)}; default: what suits the channels.")
    ] = None,
    estimator: Annotated[
        str, typer.Option(help=f"{ALL}, or some of {', '.join(ESTIMATORS)}, with commas.")
    ] = ALL,
    run: Annotated[str | None, typer.Option(help="Only these runs, such as 0,2.", metavar="N,...")] = None,
    urdf: UrdfOption = None,
    tip_frame: TipFrameOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the estimates as JSON.")] = False,
) -> None:
    """Estimate the parameters of a model, by every method, with 95 % intervals.

    Takes a session or a data file. Where the session was simulated, the truth and the errors are shown too.
    """
    names = choose_estimators(estimator)
    material = load_material(file, import_options(column, unit, where, context, fresh_runs), tared=True)
    arm = given_arm(urdf, tip_frame, material.arm)
    chosen = to_estimate(material, model, arm)
    found = [estimate_with(only_runs(channel, run), name, names, arm) for channel, name in chosen]
    if as_json:
        results = [as_data(each, material.truth_of(each.channel)) for each in found]
        cut_off = material.session is not None and material.session.truncated
        used = "+".join(dict.fromkeys(name for _, name in chosen))
        console.print_json({"file": str(file), "model": used, "cut_off": cut_off, "channels": results})
    else:
        _print(material, found)


def only_runs(channel: ChannelData, runs: str | None) -> ChannelData:
    """The channel with only the runs that the user names.

    Raises:
        InputError: the text is no list of numbers, or the channel has no such run.
    """
    if runs is None:
        return channel
    try:
        wanted = np.array([int(part) for part in runs.split(",")])
    except ValueError:
        raise InputError(f"--run {runs!r}: give numbers with commas between them, such as 0,2") from None
    if len(set(wanted.tolist())) < len(wanted):
        raise InputError(f"--run {runs}: a run is there twice")
    missing = sorted(set(wanted.tolist()) - set(channel.runs.tolist()))
    if missing:
        there = ", ".join(str(run) for run in channel.runs.tolist()[:20])
        raise InputError(
            f"--run {runs}: channel '{channel.name}' has no run {missing[0]}. There are: {there}"
        )
    return channel.of_runs(wanted)


def _print(material: Material, found: list[ChannelEstimates]) -> None:
    out = console.stdout()
    out.print(f"[bold]{shown(material.path)}[/bold]: {count(len(found), 'channel')}")
    if material.session is not None and material.session.truncated:
        out.print(
            "  [yellow]the session is cut off: what follows is from what was written until then[/yellow]"
        )
    for each in found:
        print_estimates(out, each, material.truth_of(each.channel))
    for remark in calibration_remark(material.session):
        out.print(f"  {safe(remark)}")
    if material.session is not None:
        console.next_steps((f"palpate inspect {typed(material.path)}", "see it in Rerun"))
