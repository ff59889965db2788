"""Noise floors, and typical depth, speed and force of a probing run: they scale hidden effects."""

from dataclasses import dataclass

from palpate.robot_io.errors import InputError

CONTACT = "contact"
_JOINT = "joint_"
LOADED = ("joint_1", "joint_2")
"""Joints of the shipped follower that carry weight in a probing run; the tool hangs straight down."""


def channel_of(joint: int) -> str:
    """Return the channel of a joint, such as "joint_1".

    Args:
        joint: number from 1.
    """
    return f"{_JOINT}{joint}"


def joint_of(channel: str) -> int:
    """Return the joint of a channel, from 1; the inverse of `channel_of`.

    Args:
        channel: such as "joint_1".

    Raises:
        InputError: it is not the channel of a joint.
    """
    number = channel.removeprefix(_JOINT)
    if number == channel or not number.isdecimal() or not int(number):
        raise InputError(f"channel '{channel}': is not a joint, such as joint_2")
    return int(number)


@dataclass(frozen=True, slots=True)
class JointScale:
    """Motion of one joint in a probing run; root mean squares, except the load."""

    speed_rad_s: float  # while it moves [rad/s]
    acceleration_rad_s2: float  # over the run [rad/s^2]
    middle_rad: float  # mean position [rad]
    swing_rad: float  # about it [rad]
    inertia_kg_m2: float  # least inertia that the joint feels, the others being free [kg m^2]
    load_nm: float  # mean of the absolute torque [N m]
    peak_nm: float  # largest torque [N m]
    load_rate_nm_s: float  # change of the torque [N m/s]
    weight_nm_kg: float  # torque for a mass at the tip [N m/kg]
    tilt_nm_rad: float  # torque for a tilt of the base in the arm's plane [N m/rad]

    @property
    def controllable_nm(self) -> float:
        """Largest unmodeled torque with which the shipped controller stays within 0.1 rad [N m]."""
        return 250.0 * self.inertia_kg_m2


FOLLOWER_JOINTS = (
    JointScale(0.27, 2.2, 0.70, 0.10, 0.17, 6.5, 9.0, 60.0, 3.7, 1.2),
    JointScale(0.06, 0.55, -1.50, 0.014, 0.030, 1.1, 2.1, 8.0, 1.5, 2.3),
    JointScale(0.26, 1.4, -0.79, 0.11, 0.0018, 0.008, 0.04, 0.3, 0.02, 0.3),
)
"""Measured on `palpate probe` with the shipped follower and its default plan."""


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """Noise floors, and the motion of a probing run of the shipped follower up to 10 N."""

    contact_noise_n: float  # of a force sample [N]
    joint_noise_nm: float  # of a torque sample [N m]
    depth_m: float  # at the largest force [m]
    force_n: float = 10.0  # largest force [N]
    speed_m_s: float = 0.046  # of the tip in contact, root mean square [m/s]
    session_s: float = 8.6  # how long the whole probing takes [s]
    joints: tuple[JointScale, ...] = FOLLOWER_JOINTS  # of each joint

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels in which effects can show."""
        return (CONTACT, *(channel_of(joint) for joint in range(1, len(self.joints) + 1)))

    def joint(self, channel: str) -> JointScale:
        """Return the scale of a channel's joint.

        Args:
            channel: such as "joint_1".

        Raises:
            InputError: there is no such joint.
        """
        joint = joint_of(channel)
        if joint > len(self.joints):
            raise InputError(f"channel '{channel}': no such channel. Valid: {', '.join(self.channels)}")
        return self.joints[joint - 1]

    def depth_left(self, strength: float, share: float) -> float:
        """Compute the share of the depth left at the same force if a second spring takes a part of it.

        Args:
            strength: part of the second spring's force that the first cannot mimic, as a multiple of the
                noise floor.
            share: share of this part in the second spring's force.
        """
        return max(1.0 - strength * self.contact_noise_n / (share * self.force_n), 0.25)

    def noise(self, channel: str) -> float:
        """Return the noise floor of a sample, its standard deviation in the channel's unit.

        Args:
            channel: channel of the sensor.
        """
        return self.contact_noise_n if channel == CONTACT else self.joint_noise_nm

    def peak(self, channel: str) -> float:
        """Return the largest magnitude of the signal, in the channel's unit.

        Args:
            channel: channel of the sensor.
        """
        return self.force_n if channel == CONTACT else self.joint(channel).peak_nm

    def rate(self, channel: str) -> float:
        """Return the root mean square of the signal's rate, in the channel's unit per second.

        Args:
            channel: channel of the sensor.
        """
        if channel == CONTACT:  # the other half is indistinguishable from damping
            return 0.5 * self.force_n / self.depth_m * self.speed_m_s
        return self.joint(channel).load_rate_nm_s
