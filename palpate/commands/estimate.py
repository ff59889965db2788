"""`palpate estimate`: how stiff and how damped is it?"""

from collections.abc import Sequence
from typing import Annotated

import typer

from estimation.estimators import ESTIMATORS
from estimation.study import ChannelEstimates
from estimation.study.estimates import ALL, USUAL
from palpate.common import console
from palpate.common.formatting import count, safe, shown, typed
from palpate.common.options import estimator_names
from palpate.render.estimates import as_data, calibration_remark, print_estimates
from palpate.study import Study
from palpate.workflows.data_options import DataArguments, JsonOption, ModelOption, takes_data
from robot_io.errors import InputError


@takes_data
def command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help=f"Some of {', '.join(ESTIMATORS)}, with commas. [default: {','.join(USUAL)}]",
            autocompletion=estimator_names,
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Use all estimators.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate the parameters of a model with 95 % intervals, by least squares, a robust method and RANSAC.

    Takes a session or a data file. Where the session was simulated, the truth and the errors are shown too.
    """
    if every and estimator is not None:
        raise InputError(f"--all and --estimator {estimator}: give one of them")
    study = data.study(model)
    data.say_left_out()
    estimates = study.estimate(ALL if every else USUAL if estimator is None else estimator)
    if as_json:
        results = [as_data(each, study.truth_of(each.channel)) for each in estimates]
        cut_off = study.source.session is not None and study.source.session.truncated
        used = "+".join(dict.fromkeys(each.model.name for each in estimates))
        console.print_json({"file": str(data.file), "model": used, "cut_off": cut_off, "channels": results})
    else:
        _print(data, study, estimates, model)


def _print(
    data: DataArguments, study: Study, estimates: Sequence[ChannelEstimates], model: str | None
) -> None:
    out, session = console.stdout(), study.source.session
    out.print(f"[bold]{shown(data.file)}[/bold]: {count(len(estimates), 'channel')}")
    if session is not None and session.truncated:
        out.print(
            "  [yellow]the session is cut off: what follows is from what was written until then[/yellow]"
        )
    for each in estimates:
        print_estimates(out, each, study.truth_of(each.channel))
    for remark in calibration_remark(session):
        out.print(f"  {safe(remark)}")
    steps = [(f"palpate compare {data.typed(model=model)}", "how far off the model is, and where")]
    if all(study.refusal(study.channel(each.channel.name)) for each in estimates):
        steps = [(f"palpate diagnose {data.typed(model=model)}", "why this data cannot judge a model")]
    if session is not None:
        steps.append((f"palpate inspect {typed(data.file)}", "see it in Rerun"))
    console.next_steps(*steps)
