"""Several moves of the joints, one after the other, at rest in between."""

from collections.abc import Sequence
from itertools import pairwise

from control.paths.motion import JointMotion
from control.paths.trajectory import JointBrake, JointMove
from robot_io.types import FloatArray


class JointWay:
    """From point to point, as `JointMove`.

    Args:
        points_rad: at least two joint positions, shape (n,) each [rad].
        speed_limit_rad_s: no joint moves faster [rad/s].
        acceleration_limit_rad_s2: no joint accelerates more [rad/s^2].

    Raises:
        InputError: a limit is not positive.
    """

    def __init__(
        self, points_rad: Sequence[FloatArray], speed_limit_rad_s: float, acceleration_limit_rad_s2: float
    ) -> None:
        self._points = tuple(points_rad)
        self._moves = [
            JointMove(start, end, speed_limit_rad_s, acceleration_limit_rad_s2)
            for start, end in pairwise(points_rad)
        ]
        self.duration_s = sum(move.duration_s for move in self._moves)

    def at(self, time_s: float) -> JointMotion:
        """Motion `time_s` [s] after the start; at rest at the end afterwards."""
        leg, since_s = self._leg(time_s)
        return self._moves[leg].at(since_s)

    def brake_at(self, time_s: float, acceleration_limit_rad_s2: float) -> JointBrake:
        """Come to rest on the way, from the motion at `time_s` [s] on; see `JointMove.brake_at`."""
        leg, since_s = self._leg(time_s)
        return self._moves[leg].brake_at(since_s, acceleration_limit_rad_s2)

    def passed_rad(self, time_s: float) -> tuple[FloatArray, ...]:
        """The points that lie behind at `time_s` [s], the last one first: the way back."""
        leg, _ = self._leg(time_s)
        return self._points[leg::-1]

    def _leg(self, time_s: float) -> tuple[int, float]:
        """Number of the move that is under way, and for how long it has been [s]."""
        last = len(self._moves) - 1
        for leg in range(last):
            if time_s < self._moves[leg].duration_s:
                return leg, time_s
            time_s -= self._moves[leg].duration_s
        return last, time_s
