"""Export recorded data: streams and channels as tables, layouts for viewers."""

import json
import re
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from palpate.common.table_files import NOTES
from palpate.control.loop.task import Phase
from palpate.estimation.data.channels import COLUMNS
from palpate.estimation.data.contact import STEP_COLUMN, SURFACE_COLUMN
from palpate.estimation.data.file_columns import is_session
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.source import open_source
from palpate.render import palette
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Column, Session, Stream

EVENTS = "events"
_CHANNEL = re.compile(r"contact(_\d+)?|joint_\d+")
ENDINGS = (".csv", ".parquet")
_EVENT_COLUMNS = pa.schema(
    {"time_s": pa.float64(), "kind": pa.string(), "text": pa.string(), "data": pa.string()}
)
_EFFORTS = {"force_n": "force_N", "torque_nm": "torque_Nm"}  # names that `palpate import` takes


def recorded_table(path: Path, options: ImportOptions, name: str) -> pa.Table:
    """Return a session's stream or events, or a channel of any data, as a table.

    A wide column of a stream becomes several, numbered from 1; fields keep their units. A channel has the
    names and units that `palpate import` takes, no rows before run 0, and notes on how it was read.

    Args:
        path: session, folder of sessions, or data file.
        options: options for reading a data file.
        name: name of the stream or channel, or `EVENTS`.

    Raises:
        InputError: there is none of this name, or the data cannot be used.
    """
    session = Session.open(path) if path.is_file() and is_session(path) else None
    streams = [] if session is None else [EVENTS, *session.stream_names]
    is_channel = _CHANNEL.fullmatch(name) is not None  # an imported session has a stream of the same name
    if session is not None and name in streams and not is_channel:
        if name != EVENTS:
            fields, arrays = list[pa.Field](), list[pa.Array]()
            samples = session.samples(name)
            for column in samples.stream.columns:
                vector, about = samples.vector(column.name), {"unit": column.unit, "doc": column.doc}
                for number in range(vector.shape[1]):
                    label = column.name if column.width == 1 else f"{column.name}_{number + 1}"
                    arrays.append(pa.array(np.ascontiguousarray(vector[:, number])))
                    fields.append(pa.field(label, arrays[-1].type, metadata=about))
            return pa.Table.from_arrays(arrays, schema=pa.schema(fields))
        rows = [{**vars(event), "data": json.dumps(event.data)} for event in session.events]
        return pa.Table.from_pylist(rows, _EVENT_COLUMNS)
    try:
        source = open_source(path, options)
        channels, notes = {channel.name: channel for channel in source.channels}, source.notes
    except InputError:
        if session is None or is_channel:
            raise
        channels, notes = {}, ()  # a session of streams alone
    if name not in channels:
        available = ", ".join([*streams, *(channel for channel in channels if channel not in streams)])
        raise InputError(f"{path}: has no stream or channel '{name}'. Available: {available}")
    channel = channels[name]
    motion = (channel.position, channel.velocity, channel.acceleration, channel.effort)
    names = [_EFFORTS.get(own, own) for own in COLUMNS[channel.kind]]
    for place, what in ((0, "position"), (3, "effort")):
        if unit := channel.proxy_units.get(what):
            names[place] = f"{names[place].partition('_')[0]}_{unit}"
    columns = {"time_s": channel.time_s, "run": channel.run} | dict(zip(names, motion, strict=True))
    if "position" in channel.proxy_units:  # the import derives them again, as they have no unit of its own
        del columns[names[1]], columns[names[2]]
    if channel.surface is not None:
        columns[SURFACE_COLUMN] = np.full(len(channel), channel.surface.position_m)
        columns[STEP_COLUMN] = np.full(len(channel), channel.position_step)
    columns |= {own: channel.context[own] for own in sorted(channel.recorded)}
    table = pa.table({own: pa.array(values) for own, values in columns.items()})
    known = {int(phase): phase.name.lower() for phase in Phase}
    if np.isin(channel.phase, list(known)).all():
        table = table.append_column("phase", pa.array([known[phase] for phase in channel.phase.tolist()]))
    return table.filter(pa.array(channel.run >= 0)).replace_schema_metadata({NOTES: "\n".join(notes)})


_LEFT_OUT = {"s", "1"}  # times, and numbers without unit but for the next
_STEPS = ("run", "phase")


class PlotProgram(StrEnum):
    """Viewer that opens the layout."""

    FOXGLOVE = "foxglove"
    PLOTJUGGLER = "plotjuggler"


LAYOUT_ENDINGS = {PlotProgram.FOXGLOVE: ".json", PlotProgram.PLOTJUGGLER: ".xml"}


def layout_of(session: Session, program: PlotProgram) -> str:
    """Return a viewer's layout as text; raise `InputError` if the session has nothing to plot.

    Args:
        session: session whose streams are shown.
        program: viewer that shows them.
    """
    streams = [session.samples(name).stream for name in session.stream_names]
    plots: dict[str, list[tuple[Stream, Column]]] = {}
    for stream in streams:
        for column in stream.columns:
            if column.unit not in _LEFT_OUT:
                plots.setdefault(f"{stream.name} [{column.unit}]", []).append((stream, column))
            elif column.name in _STEPS:
                plots.setdefault(f"{stream.name}: run and phase", []).append((stream, column))
    if not plots:
        raise InputError(f"{session.path}: has no stream with anything to plot")
    if program is PlotProgram.FOXGLOVE:
        panels = {}
        for number, (title, plot) in enumerate(plots.items()):
            names = _series(plot, lambda stream, column: f"{stream}.{column}")
            paths = [{"value": name, "enabled": True, "timestampMethod": "receiveTime"} for name in names]
            panels[f"Plot!{number}"] = {"title": title, "paths": paths, "showLegend": True, "isSynced": True}
        whole = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
        return json.dumps(whole | {"layout": _stacked(list(panels))}, indent=2) + "\n"
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = ElementTree.SubElement(window, "Tab", tab_name="palpate", containers="1")
    shares = ";".join([f"{1 / len(plots):.4f}"] * len(plots))
    place = ElementTree.SubElement(tab, "Container")
    split = ElementTree.SubElement(
        place, "DockSplitter", orientation="-", sizes=shares, count=str(len(plots))
    )
    for title, plot in plots.items():
        area = ElementTree.SubElement(split, "DockArea", name=title)
        drawn = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines")
        for number, curve in enumerate(_series(plot, lambda stream, column: f"{stream}/{column}")):
            color = palette.JOINTS[number % len(palette.JOINTS)]
            ElementTree.SubElement(drawn, "curve", name=curve, color=color)
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _series(plot: Sequence[tuple[Stream, Column]], name: Callable[[str, str], str]) -> list[str]:
    """Return each curve's name, one per value of a wide column; of a batch, the first record is shown."""
    return [
        name(stream.name, column.name) + ("" if column.width * stream.batch == 1 else f"[{number}]")
        for stream, column in plot
        for number in range(column.width)
    ]


def _stacked(panels: Sequence[str]) -> Any:  # noqa: ANN401, a tree of names
    """Stack panels of equal height."""
    if len(panels) == 1:
        return panels[0]
    tree = {"direction": "column", "first": panels[0], "second": _stacked(panels[1:])}
    return tree | {"splitPercentage": 100.0 / len(panels)}
