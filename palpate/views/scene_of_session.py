"""Works out what the views need from a session file."""

from collections.abc import Mapping

import numpy as np

from control.loop.tick_record import STREAM_NAME
from estimation.data.tick_check import checked_ticks
from estimation.estimate import Estimate
from palpate.findings.truth import SURFACE
from palpate.views.columns import Columns
from palpate.views.scene import Scene
from robot_io.errors import InputError
from robot_io.session import Samples, Session

VECTORS = (  # with one joint a session reads them back as scalars
    "joint_position_rad",
    "joint_velocity_rad_s",
    "torque_measured_nm",
    "torque_commanded_nm",
    "torque_sent_nm",
    "reference_position_rad",
    "reference_velocity_rad_s",
)


def scene_of_session(
    session: Session,
    truth: Mapping[str, float],
    estimate: Estimate | None,
    surface_m: float | None,
    summary: str,
) -> Scene:
    """Everything the views need.

    Args:
        session: a probing session.
        truth: see `palpate.findings.truth.true_parameters`.
        estimate: of the best estimator, if one was run.
        surface_m: the surface's coordinate along the press direction [m], as that estimator found it; None to
            take it from the online estimate, if there is one.
        summary: markdown for people.

    Raises:
        InputError: the session holds no ticks.
    """
    ticks = tick_columns(session)
    if surface_m is None:
        surface_m = _last_known(ticks["surface_m"])
    true_values = {name: value for name, value in truth.items() if name != SURFACE}
    return Scene(
        name=session.path.stem,
        ticks=ticks,
        urdf=session.metadata.urdf,
        events=session.events,
        estimate=estimate,
        surface_m=surface_m,
        truth=true_values,
        summary=summary,
    )


def has_ticks(session: Session) -> bool:
    """Whether the session was made by an arm, rather than imported."""
    return STREAM_NAME in session.stream_names and len(session.samples(STREAM_NAME)) > 1


def tick_columns(session: Session) -> Columns:
    """Columns of the "tick" stream; one value a joint even where the arm has a single joint.

    Raises:
        InputError: there are none.
    """
    if not has_ticks(session):
        raise InputError(
            f"{session.path}: holds no ticks of an arm (streams: {', '.join(session.stream_names)})"
        )
    samples = checked_ticks(session)
    return {name: _column(samples, name) for name in samples}


def _column(samples: Samples, name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return samples.vector(name) if name in VECTORS else samples[name]


def _last_known(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else None
