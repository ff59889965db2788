"""`palpate export`: the improved model as a simulated world."""

from pathlib import Path
from typing import Annotated

import typer

from estimation.channel import ChannelKind
from palpate import console
from palpate.data_options import (
    ColumnOption,
    ContextOption,
    FileArgument,
    FolderOption,
    FreshOption,
    UnitOption,
    WhereOption,
    import_options,
    retyped,
)
from palpate.export import Export, export_scenario
from palpate.export.scenario import FittedChannel
from palpate.files import output_file, write_text
from palpate.findings.derived import derived_folder, kept_revisions
from palpate.findings.effect_library import library_with
from palpate.findings.estimation_run import NO_ARM, Material, load_material
from palpate.findings.growth import Wish, grow
from palpate.findings.kept_diagnosis import kept_diagnosis
from palpate.findings.kept_revision import KeptRevision, own_effects
from palpate.findings.same_data import SameData, channel_of
from palpate.findings.truth import scenario_of
from palpate.words import safe, shown, typed
from robot_io.errors import InputError
from sim_backend.scenario import Scenario

SCENARIO = "scenario.yaml"


def command(  # noqa: PLR0917, one parameter an option
    file: FileArgument,
    revision: Annotated[
        list[int] | None,
        typer.Option(help="Take these revisions; default: each channel's newest of this data.", metavar="N"),
    ] = None,
    folder: FolderOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    where: WhereOption = None,
    context: ContextOption = None,
    fresh_runs: FreshOption = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Scenario file to write.", metavar="FILE.yaml")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there already.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what went in and what did not.")] = False,
) -> None:
    """Write the fitted models of object and joints as a scenario, so that they can be probed in simulation.

    Where the simulator cannot do what was fitted, that is said, and the rest is written.
    """
    material = load_material(file, import_options(column, unit, where, context, fresh_runs))
    shelf, place = kept_revisions(material, folder), derived_folder(material, folder)
    path = output_file(out or place / SCENARIO, force=force or out is None, keep=[file])
    library = library_with(None)
    # by which URDF an arm's models were fitted is not known here, so that those are taken as they are
    known = kept_diagnosis(place, material, NO_ARM, library.effects)
    kept = _revisions(SameData(material, NO_ARM, shelf, known, library.effects), revision)
    fitted = [_fitted(material, each) for each in kept]
    description = f"as measured in {file.name}: " + "; ".join(_model(each) for each in kept)
    export = export_scenario(_base(material), fitted, description)
    write_text(path, export.scenario.to_yaml())
    if as_json:
        console.print_json(
            {"file": str(file), "scenario": str(path), "used": export.used, "left_out": export.left_out}
        )
    else:
        data = {"column": column, "unit": unit, "where": where, "context": context, "fresh-runs": fresh_runs}
        numbers = [str(each.number) for each in kept]
        again = retyped(file, revision=numbers, folder=folder, effect=own_effects(kept), **data)
        _print(again, path, export)


def _revisions(same: SameData, numbers: list[int] | None) -> list[KeptRevision]:
    """The revisions that are meant; where nothing was added yet, the contact's base model is fitted."""
    material, shelf = same.material, same.shelf
    if numbers:
        chosen = [shelf.get(number) for number in numbers]
    else:
        newest = (same.latest(one.name) or shelf.latest(one.name) for one in material.channels)
        chosen = [revision for revision in newest if revision is not None]
    for revision in chosen:
        same.check(revision)
    contacts = [channel.name for channel in material.channels if channel.kind is ChannelKind.CONTACT]
    if len(contacts) == 1 and not any(revision.channel in contacts for revision in chosen):
        remark = "nothing was added to the contact's model yet: the base model is written as it is"
        console.stderr().print(f"[yellow]{remark}[/yellow] (palpate diagnose --apply adds what is missing)")
        wish = Wish((), channel=contacts[0])
        chosen = [*grow(material, material.arm, shelf, library_with(None), wish).kept, *chosen]
    places = ["contact" if revision.channel in contacts else revision.channel for revision in chosen]
    if twice := {place for place in places if places.count(place) > 1}:
        raise InputError(f"several revisions for one {twice.pop()}: choose one with --revision")
    if not chosen:
        raise InputError(
            f"{material.path}: no revision to write; add something first (palpate diagnose --apply)"
        )
    return chosen


def _fitted(material: Material, revision: KeptRevision) -> FittedChannel:
    channel = channel_of(material, revision)
    joints = sum(other.name.startswith("joint_") for other in material.channels)
    return FittedChannel(revision, channel.surface, joints)


def _base(material: Material) -> Scenario:
    simulated = scenario_of(material.session) if material.session is not None else None
    return simulated or Scenario()


def _model(revision: KeptRevision) -> str:
    return f"{revision.channel} {' + '.join([revision.model, *revision.effects])}"


def _print(again: str, path: Path, export: Export) -> None:
    out = console.stdout()
    out.print(f"scenario  [bold]{shown(path)}[/bold]", soft_wrap=True)
    for line in export.used:
        out.print(f"  [green]in[/green]   {safe(line)}")
    for line in export.left_out:
        out.print(f"  [yellow]out[/yellow]  {safe(line)}")
    console.next_steps(
        (f"palpate probe --scenario {typed(path)}", "probe the model as if it were the object"),
        (f"palpate compare {again}", "where the model still fails"),
    )
