"""What several hidden effects share: an effect on a sensor channel, torque and friction of a joint."""

from collections.abc import Callable, Sequence

from sim_backend.hooks import FrictionEffect, JointEffect, JointState, SensorEffect

Transducer = Callable[[float, float], float]
"""Makes (time of the sample [s], value) into another value; it may remember the samples before."""


class ChannelEffect(SensorEffect):
    """Lets one value of a sample, by its index from 0, pass through a transducer; see `SensorEffect`."""

    def __init__(self, index: int, transducer: Transducer, ahead_of_noise: bool) -> None:
        self._index = index
        self._transducer = transducer
        self.ahead_of_noise = ahead_of_noise

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] = self._transducer(time_s, changed[self._index])
        return changed


class JointTorque(JointEffect):
    """A torque that comes on top of the drive's, in the joint of an index from 0.

    `torque_nm` gives it [N m] from position [rad] and the drive's torque [N m].
    """

    def __init__(self, index: int, torque_nm: Callable[[float, float], float]) -> None:
        self._index = index
        self._torque_nm = torque_nm

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        i, changed = self._index, list(torque_nm)
        changed[i] += self._torque_nm(state.position_rad[i], state.drive_torque_nm[i])
        return changed


class JointFriction(FrictionEffect):
    """A resistance against the motion, in the joint of an index from 0.

    `resistance_nm` gives the largest one [N m] from the speed without sign [rad/s] and the drive's torque
    along the motion [N m], negative where the drive holds back.
    """

    def __init__(self, index: int, resistance_nm: Callable[[float, float], float]) -> None:
        self._index = index
        self._resistance_nm = resistance_nm

    def friction_nm(self, state: JointState, limit_nm: Sequence[float]) -> Sequence[float]:
        i, changed = self._index, list(limit_nm)
        velocity_rad_s, drive_nm = state.velocity_rad_s[i], state.drive_torque_nm[i]
        along_nm = abs(drive_nm) if drive_nm * velocity_rad_s >= 0.0 else -abs(drive_nm)
        changed[i] += self._resistance_nm(abs(velocity_rad_s), along_nm)
        return changed
