"""Hidden effects in a sensor, its statics and dynamics, and in masses and gravity."""

import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Sequence
from math import cos, exp, sin

from numpy.random import Generator

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import NotNegative, Number, Positive
from palpate.robot_io.files.urdf_text import joints_to_root, linked_name, parse_urdf
from palpate.robot_io.types import clip
from palpate.sim_backend.hooks import HiddenEffects, PlantEffect, Transducer
from palpate.sim_backend.imperfection import (
    Imperfection,
    JointImperfection,
    SensorImperfection,
    Values,
    parameter,
)
from palpate.sim_backend.noise_scale import CONTACT, LOADED, NoiseScale, channel_of, joint_of


class HiddenBias(SensorImperfection):
    """y = u + b (ISO/IEC Guide 99 (VIM), 4.20: instrumental bias)."""

    name = "bias"
    bias: Number = parameter("channel", -2.0, 2.0)  # b [channel]

    def transducer(self) -> Transducer:
        return lambda _time_s, value: value + self.bias

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; a probing run takes the force in free air as zero."""
        return {"bias": generator.choice([-1.0, 1.0]) * strength * scale.noise(channel)}


class HiddenSensorGain(SensorImperfection):
    """y = g u (1 + c u): wrong sensitivity and a curved characteristic (VIM 4.12, 4.27).

    It is visible only if the true force is known; to a probing run the object seems stiffer or softer.
    """

    name = "sensor_gain"
    shows_in = ()  # stiffness and damping take it over
    ahead_of_noise = True
    gain: Positive = parameter("-", 0.8, 1.2, le=10.0)  # g, shown over true [-]
    # c, the sensitivity's change with the signal [1/channel].
    bend: Number = parameter("1/channel", -1e-3, 1e-3, ge=-0.1, le=0.1, default=0.0)

    def transducer(self) -> Transducer:
        return lambda _time_s, value: self.gain * value * (1.0 + self.bend * value)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; for the whole change of the signal, with a known object."""
        load = scale.force_n if channel == CONTACT else 1.0
        return {"gain": 1.0 + strength * scale.noise(channel) / load}


class HiddenSaturation(SensorImperfection):
    """y = u within +- L and +- L beyond: an amplifier at its supply voltage; samples are not marked.

    If L is below the desired force, an arm that controls the force presses on to its depth limit.
    """

    name = "saturation"
    shows_in = LOADED  # the arm loads the object by the force sensor itself
    limit: Positive = parameter("channel", 0.5, 50.0)  # L [channel]

    def transducer(self) -> Transducer:
        return lambda _time_s, value: clip(value, -self.limit, self.limit)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        if not strength:
            return {"limit": 1e9}
        peak = scale.peak(channel)
        return {"limit": max(peak - 5.0 * strength * scale.noise(channel), 0.2 * peak)}


class HiddenDeadband(SensorImperfection):
    """y = 0 within +- w, and u - w or u + w beyond: lost motion before the sensing element (VIM 4.17)."""

    name = "deadband"
    # The last joint has next to no torque to be wrong about.
    shows_in = (CONTACT, *LOADED)
    ahead_of_noise = True
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        return lambda _time_s, value: value - clip(value, -self.half_width, self.half_width)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"half_width": strength * scale.noise(channel)}


class HiddenQuantisation(SensorImperfection):
    """y = s round(u / s), after the noise (Widrow and Kollar, "Quantization Noise", 2008, ch. 1)."""

    name = "quantisation"
    # The last joint has next to no torque to be wrong about.
    shows_in = (CONTACT, *LOADED)
    step: NotNegative = parameter("channel", 0.02, 1.0)  # s [channel]

    def transducer(self) -> Transducer:
        return lambda _time_s, value: round(value / self.step) * self.step if self.step else value

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; a step is sqrt(12) times the rms of its rounding error."""
        return {"step": 3.46 * strength * scale.noise(channel)}


class HiddenDrift(SensorImperfection):
    """y = u + r (t - t0), t0 the time of the first sample: a sensor that warms up (VIM 4.21)."""

    name = "drift"
    rate_1_s: Number = parameter("channel/s", -0.5, 0.5)  # r [channel/s]

    def transducer(self) -> Transducer:
        start_s: float | None = None

        def wandering(time_s: float, value: float) -> float:
            nonlocal start_s
            start_s = time_s if start_s is None else start_s
            return value + self.rate_1_s * (time_s - start_s)

        return wandering

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        sign = generator.choice([-1.0, 1.0])
        return {"rate_1_s": sign * strength * scale.noise(channel) / (0.4 * scale.session_s)}


class _Mechanical(SensorImperfection):
    """A sensor with a lag; effects in the last joint's torque are hardly visible."""

    shows_in = (CONTACT, *LOADED)
    ahead_of_noise = True


class HiddenHysteresis(_Mechanical):
    """y follows u with a play of +- w: lower by up to w while u rises, higher by up to w while it falls.

    The play operator, from which Prandtl and Ishlinskii build all hysteresis; Brokate and Sprekels,
    "Hysteresis and Phase Transitions", 1996.
    """

    name = "hysteresis"
    half_width: NotNegative = parameter("channel", 0.02, 1.0)  # w [channel]

    def transducer(self) -> Transducer:
        output: float | None = None

        def play(_time_s: float, value: float) -> float:
            nonlocal output
            last_output = value if output is None else output
            output = max(value - self.half_width, min(value + self.half_width, last_output))
            return output

        return play

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"half_width": strength * scale.noise(channel)}


class HiddenLag(_Mechanical):
    """T dy/dt = u - y: a filter in the amplifier or a soft cell (first-order low-pass).

    Exact for a signal that changes at a constant rate between two samples.
    """

    name = "lag"
    time_s: NotNegative = parameter("s", 0.001, 0.05, le=10.0)  # T [s]

    def transducer(self) -> Transducer:
        last: tuple[float, float, float] | None = None  # time, value and output

        def following(time_s: float, value: float) -> float:
            nonlocal last
            output = value
            if last is not None and self.time_s:
                last_s, last_value, last_output = last
                steps = (time_s - last_s) / self.time_s
                decay, lag = exp(-steps), (value - last_value) / steps
                output = value - lag + decay * (last_output - last_value + lag)
            last = time_s, value, output
            return output

        return following

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"time_s": min(strength * scale.noise(channel) / scale.rate(channel), 0.1)}


class HiddenDelay(_Mechanical):
    """y(t) = u(t - d) with time stamp t: a converter or bus whose delay is not in the stamp.

    The signal is interpolated linearly between two samples.
    """

    name = "delay"
    delay_s: NotNegative = parameter("s", 0.0005, 0.02, le=1.0)  # d [s]

    def transducer(self) -> Transducer:
        samples: deque[tuple[float, float]] = deque()

        def late(time_s: float, value: float) -> float:
            delayed_s = time_s - self.delay_s
            samples.append((time_s, value))
            while len(samples) > 1 and samples[1][0] <= delayed_s:
                samples.popleft()
            (first_s, first), (second_s, second) = samples[0], samples[min(1, len(samples) - 1)]
            if delayed_s <= first_s or second_s <= first_s:
                return first
            return first + (second - first) * (delayed_s - first_s) / (second_s - first_s)

        return late

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"delay_s": min(strength * scale.noise(channel) / scale.rate(channel), 0.1)}


_RADIUS_M = 0.01


class HiddenPayload(JointImperfection, PlantEffect):
    """A small ball of mass m at the far end of a link: at the next joint, or at the tip.

    It has weight and inertia, and shows in the joint that moves the link and in those before it.
    """

    name = "payload"
    shows_in = LOADED  # a vertical tool has no lever at its joint
    # M [kg]; scaled by the arm's mass_scale as the rest of it.
    mass_kg: NotNegative = parameter("kg", 0.005, 1.0, le=50.0)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(channel_of(joint) for joint in range(1, self.joint + 1))

    def _effects(self, index: int, joint_count: int) -> HiddenEffects:
        return HiddenEffects(plant=(self,)) if self.mass_kg else HiddenEffects()

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; at the tip."""
        mass_kg = strength * scale.joint_noise_nm / scale.joint(channel).weight_nm_kg
        return {"joint": max(len(scale.joints), joint_of(channel)), "mass_kg": mass_kg}

    def urdf(self, urdf_text: str, tip_frame: str) -> str:
        """Add a link with the ball's mass and inertia, 2/5 m r^2, at the far end of its link."""
        try:
            robot = parse_urdf(urdf_text)
        except ValueError as error:
            raise InputError(f"URDF: {error}") from error
        movable = [joint for joint in joints_to_root(robot, tip_frame)[::-1] if joint.get("type") != "fixed"]
        carrier, xyz = tip_frame, "0 0 0"
        if self.joint < len(movable):
            carrier = linked_name(movable[self.joint], "parent")
            if (origin := movable[self.joint].find("origin")) is not None:
                xyz = origin.get("xyz", xyz)
        name = f"hidden_payload_{len(robot.findall('link'))}"
        inertial = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
        ET.SubElement(inertial, "mass", value=repr(self.mass_kg))
        moment = repr(0.4 * self.mass_kg * _RADIUS_M**2)
        ET.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")
        mount = ET.SubElement(robot, "joint", name=f"{name}_mount", type="fixed")
        ET.SubElement(mount, "parent", link=carrier)
        ET.SubElement(mount, "child", link=name)
        ET.SubElement(mount, "origin", xyz=xyz)
        return ET.tostring(robot, encoding="unicode")


class HiddenGravityTilt(Imperfection, PlantEffect):
    """Gravity is rotated relative to the arm's base, g = R^T (0, 0, -9.81): the table is not level.

    R turns the base by `pitch_rad` about its y axis, x dipping, after `roll_rad` about its x axis. The object
    is tilted with it. An arm that moves in the x-z plane is affected only by the pitch.
    """

    name = "gravity_tilt"
    shows_in = LOADED
    pitch_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6)  # about y [rad]
    roll_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6, default=0.0)  # about x [rad]

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the base's joint carries most of the arm, later joints less."""
        return tuple(channel_of(joint) for joint in (1, 2, 3))

    def effects(self, joint_count: int) -> HiddenEffects:
        """See `Imperfection.effects`; gravity is that of the whole arm."""
        return HiddenEffects(plant=(self,))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        sign = generator.choice([-1.0, 1.0])
        return {"pitch_rad": sign * strength * scale.joint_noise_nm / scale.joint(channel).tilt_nm_rad}

    def gravity_m_s2(self, gravity_m_s2: Sequence[float]) -> Sequence[float]:
        """Turn gravity into the tilted base's frame: back about y, then about x."""
        x, y, z = gravity_m_s2
        c, s = cos(self.pitch_rad), sin(self.pitch_rad)
        x, z = c * x - s * z, s * x + c * z
        c, s = cos(self.roll_rad), sin(self.roll_rad)
        return x, c * y + s * z, -s * y + c * z
