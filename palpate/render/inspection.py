"""Make all displays of a session: the Rerun recording and a page of plots."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.common.console import count
from palpate.common.files import write_text
from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.channels import session_channels
from palpate.estimation.data.tick_channels import checked_ticks
from palpate.estimation.estimate import with_unit
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.channels import CONTACT_MODEL
from palpate.estimation.study.estimates import PREFERRED, ChannelEstimates
from palpate.render.build import channel_view
from palpate.render.estimates import estimates_view, markdown_summary
from palpate.render.recording.revisions import record_rerun
from palpate.render.recording.scene import VECTORS, Columns, Scene
from palpate.render.recording.session import record_session
from palpate.render.report import document
from palpate.render.view import ChannelView, StudyView, VerdictView
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.atomic_write import replace_undecodable
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import SURFACE, scenario_of, truth_of

RECORDING = "recording.rrd"  # default name in a session's folder
PLOTS = "plots.html"  # what `Inspection.plot` writes


@dataclass(frozen=True)
class Inspection:
    """A session with its estimates, ready to be shown."""

    session: Session  # recorded session
    view: StudyView  # its channels with the estimate of the first place that was touched
    scene: Scene | None  # data for the views of an arm; None for an imported session

    def record(self, path: Path) -> float:
        """Write the Rerun recording.

        Args:
            path: path of the .rrd file.

        Returns:
            Time to use for a screenshot [s].

        Raises:
            InputError: the file cannot be written.
        """
        if self.scene is None:
            record_rerun(self.view, path)
            return float(self.view.channels[0].time_s[-1] / 2)
        record_session(self.scene, path)
        return self.scene.picture_moment_s

    def plot(self, folder: Path) -> Path:
        """Save a page of plots; return the file.

        Args:
            folder: an existing folder.

        Raises:
            InputError: nothing was touched, or the file cannot be written.
        """
        if not any(channel.stages for channel in self.view.channels):
            raise InputError(f"{self.session.path}: nothing was touched, so there is nothing to plot")
        write_text(folder / PLOTS, document(self.view))
        return folder / PLOTS


def inspect_session(session: Session, estimates: ChannelEstimates | None = None) -> Inspection:
    """Estimate a session's channels, and collect the data to show.

    Args:
        session: a probing session or an imported one.
        estimates: estimates, if they were made already.

    Raises:
        InputError: the session contains no data that can be shown.
    """
    try:
        channels = session_channels(session, tared=True)
    except InputError:  # the session ended before its first run was complete
        channels = ()
    contact = next((channel for channel in channels if channel.kind is ChannelKind.CONTACT), None)
    if estimates is None and contact is not None:
        with suppress(InputError):  # too few contact samples for an estimate
            untared = [channel for channel in session_channels(session) if channel.name == contact.name]
            estimates = ModelStudy(untared, CONTACT_MODEL).estimate(PREFERRED, contact.name)[0]
    truth = truth_of(scenario_of(session))
    ticks: Columns | None = None  # of an arm's session, with two dimensions for vectors of a single joint too
    if STREAM_NAME in session.stream_names and len(session.samples(STREAM_NAME)) >= 2:
        samples = checked_ticks(session)
        ticks = {name: samples.vector(name) if name in VECTORS else samples[name] for name in samples}
    if ticks is None and not channels:
        raise InputError(f"{session.path}: holds nothing that can be shown")
    metadata, facts = session.metadata, dict[str, str]()
    if channels:
        facts["data"] = f"{count(len(channels[0].runs), 'run')}, {count(len(channels[0]), 'sample')}"
    facts |= {"recorded": metadata.created_utc, "by": metadata.command_line}
    views = tuple(_view(each, estimates, truth, ticks) for each in channels)
    view = StudyView(session.path.name, views, {name: value for name, value in facts.items() if value})
    if ticks is None:
        return Inspection(session, view, None)
    surface = estimates.surface_of(estimates.best) if estimates else None
    online_m = ticks["surface_m"][np.isfinite(ticks["surface_m"])]
    last_m = float(online_m[-1]) if len(online_m) else None
    name = session.path.stem
    summary = f"**{name}**: nothing was touched"
    if estimates is not None:
        summary = markdown_summary(estimates, truth, name)
    scene = Scene(
        name=name,
        ticks=ticks,
        urdf=metadata.urdf,
        events=session.events,
        estimate=estimates.best if estimates else None,
        surface_m=surface.position_m if surface else last_m,
        truth={name: value for name, value in truth.items() if name != SURFACE},
        summary=replace_undecodable(summary),
    )
    return Inspection(session, view, scene)


def _view(
    channel: ChannelData,
    estimates: ChannelEstimates | None,
    truth: Mapping[str, float],
    ticks: Columns | None,
) -> ChannelView:
    """Make the view of a channel with its commanded effort, and its estimates if they are of this channel."""
    if estimates is not None and channel.name == estimates.channel.name:
        view = estimates_view(estimates, truth)
        if ticks is None:
            return view
        tick = np.searchsorted(ticks["time_s"], estimates.channel.time_s)
        desired_n = ticks["desired_force_n"][np.minimum(tick, len(ticks["time_s"]) - 1)]  # NaN in free air
        return replace(view, commanded=("reference", desired_n))
    view = channel_view(channel, (), None)
    joint = re.fullmatch(r"joint_(\d+)", channel.name)
    if ticks is None or joint is None:
        return view
    # Torque last sent before each sample [N m]; NaN before the first. A value read in a tick
    # was sampled before that tick's own torque was sent.
    held = np.searchsorted(ticks["time_s"], channel.time_s) - 1
    sent = np.where(held >= 0, ticks["torque_sent_nm"][held, int(joint[1]) - 1], np.nan)
    rms = float(np.sqrt(np.nanmean((channel.effort - sent) ** 2)))
    difference = with_unit(rms, channel.effort_unit)
    sentence = f"{channel.name}: measured and sent torque differ by {difference} (rms)."
    return replace(view, verdict=VerdictView("", sentence), commanded=("sent", sent))
