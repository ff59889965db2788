"""Makes everything that can be looked at from a session: the Rerun recording and the plots."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from control.loop.phases import Phase
from estimation.channel import ChannelData, ChannelKind
from estimation.data.channels import session_channels
from palpate.findings.estimation_run import BEST, DEFAULT_MODEL, ChannelEstimates, estimate_with
from palpate.findings.truth import true_parameters
from palpate.text.estimate_report import markdown_summary
from palpate.views.plots import save_plots
from palpate.views.recording import write_channels, write_recording
from palpate.views.scene import Scene
from palpate.views.scene_of_session import has_ticks, scene_of_session
from robot_io.errors import InputError
from robot_io.session import Session

RECORDING = "recording.rrd"  # its name in a session's folder, if nobody says another


@dataclass(frozen=True)
class Inspection:
    """A session with what was estimated from it, ready to be shown.

    Attributes:
        session: what happened.
        channels: what was measured; empty if no run is whole.
        found: Kelvin-Voigt, or another model, of the first place that was touched; None where nothing was.
        scene: for the views of an arm; None where the session was imported.
    """

    session: Session
    channels: tuple[ChannelData, ...]
    found: ChannelEstimates | None
    scene: Scene | None

    def record(self, path: Path) -> float:
        """Write the Rerun recording.

        Returns:
            A moment worth a picture [s].

        Raises:
            InputError: the file cannot be written.
        """
        if self.scene is None:
            name = self.session.path.stem
            return write_channels(name, self.channels, self.found, _summary(self.session, self.found), path)
        write_recording(self.scene, path)
        return picture_moment_s(self.scene)

    def plot(self, folder: Path) -> list[Path]:
        """Save the plots in a folder that is there; returns the files.

        Raises:
            InputError: nothing was touched, or a file cannot be written.
        """
        if self.found is None:
            raise InputError(f"{self.session.path}: nothing was touched, so there is nothing to plot")
        return save_plots(self.scene.ticks if self.scene else None, self.found, folder)


def look_into(session: Session, found: ChannelEstimates | None = None) -> Inspection:
    """Work out what is to be shown.

    Args:
        session: a probing session or an imported one.
        found: estimates, if they were made already.

    Raises:
        InputError: the session holds nothing that can be shown.
    """
    channels = _channels(session)
    found = found or _estimates(channels)
    if not has_ticks(session):
        if not channels:
            raise InputError(f"{session.path}: holds nothing that can be shown")
        return Inspection(session, channels, found, None)
    surface = found.surface_of(found.best) if found else None
    scene = scene_of_session(
        session,
        true_parameters(session),
        found.best if found else None,
        surface.position_m if surface else None,
        _summary(session, found),
    )
    return Inspection(session, channels, found, scene)


def _channels(session: Session) -> tuple[ChannelData, ...]:
    """The channels; none where the session ended before the first run was whole."""
    try:
        return session_channels(session, tared=True)
    except InputError:
        return ()


def _estimates(channels: tuple[ChannelData, ...]) -> ChannelEstimates | None:
    """Of the first place that was touched; None where nothing was, or too little to estimate from."""
    contact = next((channel for channel in channels if channel.kind is ChannelKind.CONTACT), None)
    if contact is None:
        return None
    try:
        return estimate_with(contact, DEFAULT_MODEL, BEST)
    except InputError:
        return None


def _summary(session: Session, found: ChannelEstimates | None) -> str:
    name = session.path.stem
    return (
        markdown_summary(found, true_parameters(session), name)
        if found
        else f"**{name}**: nothing was touched"
    )


def picture_moment_s(scene: Scene) -> float:
    """While the force is held for the last time, or the middle of the session [s]."""
    holding = np.flatnonzero(scene.ticks["phase"] == Phase.HOLD)
    if not len(holding):
        return float(scene.time_s[len(scene.time_s) // 2])
    last_run = scene.ticks["run"][holding[-1]]
    of_last = holding[scene.ticks["run"][holding] == last_run]
    return float(scene.time_s[of_last[len(of_last) // 2]])
