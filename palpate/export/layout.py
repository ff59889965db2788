"""Layouts in which Foxglove and PlotJuggler show a session: one plot for each unit of each stream.

Foxglove: docs.foxglove.dev, message path syntax and plot panel. PlotJuggler names a series of a protobuf
message "topic/field", and of a repeated field "topic/field[0]" (its plugin ParserProtobuf).
"""

import json
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Any
from xml.etree import ElementTree

from palpate.render import palette
from robot_io.errors import InputError
from robot_io.session import Column, Session, Stream

_LEFT_OUT = {"s", "1"}  # times, and numbers without unit but for the next
_STEPS = ("run", "phase")


class Program(StrEnum):
    """What opens the layout."""

    FOXGLOVE = "foxglove"
    PLOTJUGGLER = "plotjuggler"


ENDINGS = {Program.FOXGLOVE: ".json", Program.PLOTJUGGLER: ".xml"}
Plots = Mapping[str, Sequence[tuple[Stream, Column]]]  # by title


def layout_of(session: Session, program: Program) -> str:
    """The text of a layout. InputError: the session has nothing to plot."""
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
    return _foxglove(plots) if program is Program.FOXGLOVE else _plotjuggler(plots)


def _series(plot: Sequence[tuple[Stream, Column]], name: Callable[[str, str], str]) -> list[str]:
    """What a program calls each curve of a plot; of a wide column each of its values.

    Where a message holds many records of a long stream, the first of each is shown.
    """
    return [
        name(stream.name, column.name) + ("" if column.width * stream.batch == 1 else f"[{number}]")
        for stream, column in plot
        for number in range(column.width)
    ]


def _foxglove(plots: Plots) -> str:
    panels = {}
    for number, (title, plot) in enumerate(plots.items()):
        names = _series(plot, lambda stream, column: f"{stream}.{column}")
        paths = [{"value": name, "enabled": True, "timestampMethod": "receiveTime"} for name in names]
        panels[f"Plot!{number}"] = {"title": title, "paths": paths, "showLegend": True, "isSynced": True}
    whole = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps(whole | {"layout": _stacked(list(panels))}, indent=2) + "\n"


def _stacked(panels: Sequence[str]) -> Any:  # noqa: ANN401, a tree of names
    """Panels one above the other, each as high."""
    if len(panels) == 1:
        return panels[0]
    tree = {"direction": "column", "first": panels[0], "second": _stacked(panels[1:])}
    return tree | {"splitPercentage": 100.0 / len(panels)}


def _plotjuggler(plots: Plots) -> str:
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
        for number, one in enumerate(_series(plot, lambda stream, column: f"{stream}/{column}")):
            color = palette.JOINTS[number % len(palette.JOINTS)]
            ElementTree.SubElement(drawn, "curve", name=one, color=color)
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
