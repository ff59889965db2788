"""A probing that goes on, served to Foxglove: for who has that open, beside the page."""

from pathlib import Path
from threading import Lock

import numpy as np

from robot_io.errors import InputError
from robot_io.session import Samples
from robot_io.types import FloatArray, IntArray

TOPIC = "/probing"
_NUMBERS = {
    "force_n": "measured force [N]",
    "residual_n": "force less that of the online estimates [N]",
    "stiffness_n_m": "online estimate of k [N/m]",
    "damping_n_s_m": "online estimate of c [N s/m]",
}
_SCHEMA = {
    "title": "palpate.Probing",
    "type": "object",
    "properties": {
        **{name: {"type": "number", "description": text} for name, text in _NUMBERS.items()},
        "torque_nm": {"type": "array", "items": {"type": "number"}, "description": "of each joint [N m]"},
    },
}
_MOST_WAITING = 30_000  # messages that are kept for a slow viewer
_NS = 1e9


class Feed:
    """A Foxglove WebSocket server; it sends each tick once, at its time in the session.

    Args:
        host: address that it listens at.
        port: 0 for any free one.

    Raises:
        InputError: the Foxglove SDK is not installed, or the port cannot be had.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            import foxglove  # noqa: PLC0415, an extra
        except ImportError as error:
            raise InputError(
                "--foxglove: the package foxglove-sdk is not installed: pip install foxglove-sdk"
            ) from error
        try:
            self._server = foxglove.start_server(
                name="palpate", host=host, port=port, message_backlog_size=_MOST_WAITING
            )
        except (OSError, RuntimeError) as error:
            said = f"--foxglove {port}: in use, or not permitted; another, or 0 for any free one"
            raise InputError(said) from error
        self._channel = foxglove.Channel(TOPIC, schema=_SCHEMA)
        self.port = int(self._server.port)
        self._lock = Lock()  # pages follow a session in threads of their own
        self._sent: dict[Path, float] = {}  # until when of each session [s]

    @property
    def is_watched(self) -> bool:
        """Whether anybody has subscribed."""
        return bool(self._channel.has_sinks())

    def send(self, session: Path, ticks: Samples) -> None:
        """Send what is newer than what was sent of the session before; to nobody, nothing is sent."""
        if not self.is_watched:
            return
        time_s = ticks["time_s"]
        with self._lock:
            new = time_s > self._sent.get(session, -np.inf)
            if not new.any():
                return
            self._sent[session] = float(time_s.max())
            self._send(ticks, np.flatnonzero(new))

    def _send(self, ticks: Samples, rows: IntArray) -> None:
        columns = {n: online_residual(ticks) if n == "residual_n" else ticks[n] for n in _NUMBERS}
        torques = ticks.vector("torque_measured_nm")
        time_s = ticks["time_s"]
        for row in rows:
            # what is not there yet, such as an estimate in free air, is left out: JSON has no NaN
            message: dict[str, object] = {
                name: float(values[row]) for name, values in columns.items() if np.isfinite(values[row])
            }
            if np.isfinite(torques[row]).all():
                message["torque_nm"] = torques[row].tolist()
            self._channel.log(message, log_time=int(time_s[row] * _NS))

    def close(self) -> None:
        """End the server."""
        self._channel.close()
        self._server.stop()


def online_residual(ticks: Samples) -> FloatArray:
    """Force less that of the online estimates of k, c and surface, (n,) [N]; NaN where there are none."""
    along = np.sum(ticks["tip_position_world_m"] * ticks["press_direction_world"], axis=1)
    speed = np.sum(ticks["tip_velocity_world_m_s"] * ticks["press_direction_world"], axis=1)
    depth = along - ticks["surface_m"]
    expected = np.where(depth > 0.0, ticks["stiffness_n_m"] * depth + ticks["damping_n_s_m"] * speed, 0.0)
    left: FloatArray = ticks["force_n"] - np.maximum(expected, 0.0)
    return left
