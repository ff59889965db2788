"""Where the tip meets the object, whose law can change meanwhile: depth, rate, and the force between them."""

from collections.abc import Sequence

from sim_backend.contact_law import ContactLaw
from sim_backend.contact_laws import EngineContact
from sim_backend.engines import Engine
from sim_backend.hooks import ContactState, Effects
from sim_backend.object_answer import ObjectAnswer


class ComplianceObject:
    """A horizontal surface, frictionless, that answers depth and rate with an upward force.

    Its world height is that of the undeformed surface [m]. `is_engine_contact` is whether the engine itself
    exerts the force. InputError: the law is an engine's own contact, and this engine has none.
    """

    def __init__(self, engine: Engine, law: ContactLaw, surface_height_m: float) -> None:
        self._engine = engine
        self._surface_height_m = surface_height_m
        self.set_law(law)

    @property
    def law(self) -> ContactLaw:
        """The contact law in force."""
        return self._law

    @property
    def surface_height_m(self) -> float:
        """World height of the undeformed surface [m]."""
        return self._surface_height_m

    def set_law(self, law: ContactLaw) -> None:
        """Change the law, from the next physics step on. InputError: the engine has no such contact."""
        self._tell_engine(law, self._surface_height_m)
        self._law = law
        self.is_engine_contact = isinstance(law, EngineContact)  # takes long: asked here, not at each step

    def move_surface(self, height_m: float) -> None:
        """Change the world height of the undeformed surface [m], from the next physics step on."""
        self._tell_engine(self._law, height_m)
        self._surface_height_m = height_m

    def _tell_engine(self, law: ContactLaw, height_m: float) -> None:
        self._engine.set_surface(law if isinstance(law, EngineContact) else None, height_m)


class Contact:
    """The touch of one arm's tip on one object.

    The engine integrates by semi-implicit Euler: v(n+1) = v(n) + h a(n), x(n+1) = x(n) + h v(n+1), so its
    velocity belongs to the middle of the last step, half a step before its position. The law is given the
    rate at the time of the depth, (3 v(n) - v(n-1)) / 2. That makes contact accurate to the second order in
    h (leapfrog for the spring, Adams-Bashforth for the damper), and depth, rate and force of one state belong
    together. Of the effects those of contact and tool act here.

    Attributes:
        depth_m: how far the tip is below the undeformed surface [m]; negative above it.
        rate_m_s: d(depth)/dt [m/s].
        force_n: force of the object on the tip, upwards [N].
        push_n: the part of it that the engine does not exert by itself, to be applied in the next step [N].
        tip_position_m: of the tip frame in the world (3) [m].
    """

    def __init__(self, engine: Engine, target: ComplianceObject, step_s: float, effects: Effects) -> None:
        self._engine = engine
        self._object = target
        self._step_s = step_s
        self._answer = ObjectAnswer(effects)
        self._speed_before_m_s: float | None = None

    def update(self, time_s: float) -> None:
        """Work out what holds at the arm's present state, reached at `time_s` [s] by a step."""
        self.tip_position_m, velocity, self._quaternion = self._engine.tip_state()
        speed, before = -velocity[2], self._speed_before_m_s
        self._speed_before_m_s = speed
        self.rate_m_s = speed if before is None else 1.5 * speed - 0.5 * before
        self.depth_m = self._object.surface_height_m - self.tip_position_m[2]
        self._update_force(time_s)

    def restart(self) -> None:
        """Forget the speed of the step before, after the arm was put elsewhere."""
        self._speed_before_m_s = None

    def _update_force(self, time_s: float) -> None:
        by_engine_n = self._engine.surface_force_n() if self._object.is_engine_contact else None
        state = ContactState(time_s, self._step_s, self.depth_m, self.rate_m_s)
        self.force_n = self._answer.force_n(self._object.law, state, by_engine_n)
        self.push_n = self.force_n - (by_engine_n or 0.0)

    def compression_n(self, sensor_axis_tip: Sequence[float]) -> float:
        """The part of the force that lies along the sensor axis, positive in compression [N].

        A uniaxial sensor sees the force times the cosine of the tool's tilt. Its axis is a unit vector in the
        tip frame, along which the tool pushes.
        """
        x, y, z, w = self._quaternion
        a, b, c = sensor_axis_tip
        axis_up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
        return -axis_up * self.force_n
