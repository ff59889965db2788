"""`palpate effects`: list and draw the effects of the library."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from palpate.common import console
from palpate.common.console import shell_path
from palpate.common.files import existing_data
from palpate.common.options import JsonOption, effect_names
from palpate.estimation.effects import EFFECTS
from palpate.render.effects import EffectExample, as_data, kind_of, library, print_effect, print_library
from palpate.robot_io.errors import InputError
from palpate.sim_backend.imperfection import IMPERFECTIONS

_NAME = "Effect to show in detail, with a drawing."
_ON = "Session or data file; the effect is drawn on its motion, beside the fitted model."


def effects_command(
    name: Annotated[str | None, Argument(help=_NAME, metavar="[NAME]", autocompletion=effect_names)] = None,
    on: Annotated[Path | None, Option(help=_ON, metavar="FILE")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the effects that a model may lack, or show one effect with its equation and a drawing.

    Examples:
      palpate effects
      palpate effects backlash
      palpate effects cubic_stiffness --on press.csv
    """
    if name is None:
        if on is not None:
            raise InputError(f"--on {on}: name an effect to draw")
        steps = [
            ("palpate effects NAME", "one effect in full, with a drawing"),
            ("palpate diagnose FILE", "find which of these effects a measurement shows"),
        ]
        content = {"effects": list(map(as_data, library()))}
        console.present(content, lambda: print_library(console.stdout(), library()), steps, as_json=as_json)
        return
    effect = EFFECTS[name]()
    if as_json:
        console.print_json(as_data(effect))
        return
    if on is None:
        example = EffectExample.on_simple_motion(effect, kind_of(effect))
    else:  # the first channel to which the effect applies
        from palpate.study import Study  # noqa: PLC0415, takes a second

        study = Study(existing_data(on), keep=False)
        fits = (
            study.fit(channel)
            for channel in study.channels
            if channel.kind in effect.channels
            and effect.name not in {part.name for part in channel.model.effects}
        )
        examples = (
            EffectExample.on_fitted_motion(fitted, suited)
            for fitted in fits
            if (suited := effect.suited_to(fitted.data)).applies_to(fitted.data)
        )
        example = next(examples, None)
        if example is None:
            channels = ", ".join(f"{channel.name} ({channel.model.name})" for channel in study.channels)
            raise InputError(f"{on}: {effect.name} does not apply to any of its channels: {channels}")
    print_effect(console.stdout(), effect, example)
    steps = [(f"palpate effects {name} --on FILE", "draw it on a motion of your own")] if on is None else []
    if name in IMPERFECTIONS:
        steps.append(
            (f"palpate probe --hidden {name} -o {name}.mcap", "hide it in a simulated world, and find it")
        )
    file = "FILE" if on is None else shell_path(on)
    steps.append((f"palpate add {file} {name}", "add it to the model of a measurement"))
    console.next_steps(*steps)
