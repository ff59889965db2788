"""Contact of the tip with the object: depth, rate, and the force between them."""

from collections.abc import Callable, Sequence
from functools import partial

from palpate.sim_backend.contact_laws import ObjectLaw
from palpate.sim_backend.contact_laws.standard import EngineContact
from palpate.sim_backend.engines import Engine
from palpate.sim_backend.hooks import ContactEffect, ContactState, HiddenEffects, MaterialEffect, ToolEffect

_RECOVERED_M = 1e-9  # depth from which a free surface counts as recovered


class ObjectResponse:
    """Force of an object on the tip: its law, with hidden effects in material, surface and tool.

    Where the tip does not push, the surface is free: law and material exert no force, and the surface
    recovers as fast as they allow. A spring and a damper recover with the time constant c / k (T. C. T. Ting,
    J. Appl. Mech. 33, 1966). The tip touches the surface again where it is then. The surface of the engine's
    own contact recovers at once, and adhesion refers to the undeformed surface.

    Args:
        effects: hidden effects; those of contact and tool act here.
    """

    def __init__(self, effects: HiddenEffects) -> None:
        self._memories: list[ContactEffect | ToolEffect] = [*effects.contact, *effects.tool]
        self._material = [effect for effect in effects.contact if isinstance(effect, MaterialEffect)]
        self._skin = [effect for effect in effects.contact if not isinstance(effect, MaterialEffect)]
        self._tools = effects.tool
        # Depth of the surface [m], and whether the tip touches it: after the last completed step, and call.
        self._surface = self._tried_surface = 0.0, False

    def force_n(self, law: ObjectLaw, state: ContactState, engine_force_n: float | None = None) -> float:
        """Compute the force on the tip along the surface normal [N], and update the effects' memories.

        Args:
            law: contact law of the object.
            state: motion of the tip.
            engine_force_n: force that the engine exerts, which replaces the law [N]; None if it exerts none.
        """
        answer_n: Callable[[ContactState], float] = partial(self._object_n, law, engine_force_n)
        for tool in self._tools:
            answer_n = partial(tool.contact_force_n, surface_n=answer_n)
        force_n = answer_n(state)
        for memory in self._memories:
            memory.commit_state()
        self._surface = self._tried_surface
        return force_n

    def _object_n(self, law: ObjectLaw, engine_force_n: float | None, state: ContactState) -> float:
        """Compute the force of law and effects for a motion, which may be a trial of a solver [N]."""
        for material in self._material:
            state = material.transform_state(state)
        if engine_force_n is None:
            touching, force_n = self._find_surface(law, state)
        else:
            touching, force_n = state, self._material_n(state, engine_force_n)
        for material in self._material:
            if material.acts_on_tip:
                force_n = material.contact_force_n(touching, force_n)
        if force_n < 0.0 and not law.can_pull:
            force_n = 0.0
        for effect in self._skin:
            force_n = effect.contact_force_n(state, force_n)
        return force_n

    def _find_surface(self, law: ObjectLaw, state: ContactState) -> tuple[ContactState, float]:
        """Return the motion of the tip, its depth at most 0 where it does not touch, and the force [N]."""
        before_m, was_touching = self._surface
        if state.depth_m <= 0.0 and not (before_m or self._material):  # free air, for speed
            self._tried_surface = 0.0, False
            return state, 0.0

        def moved_n(surface_m: float) -> float:
            """Return the force of law and material if the surface moves there within the step [N]."""
            rate_m_s = (surface_m - before_m) / state.step_s
            moved = state._replace(depth_m=surface_m, rate_m_s=rate_m_s)
            return self._material_n(moved, law.material_force_n(surface_m, rate_m_s))

        depth_m = state.depth_m
        if depth_m > 0.0 and (was_touching or moved_n(depth_m) > 0.0):
            force_n = self._material_n(state, law.material_force_n(depth_m, state.rate_m_s))
            if force_n > 0.0 or law.can_pull or not was_touching:
                self._tried_surface = depth_m, True
                return state, force_n
        surface_m = max(depth_m, _RECOVERED_M)
        if before_m > surface_m and moved_n(surface_m) < 0.0 <= moved_n(before_m):
            from scipy.optimize import brentq  # noqa: PLC0415, slow to load, and seldom needed

            surface_m = brentq(moved_n, surface_m, before_m, xtol=1e-3 * _RECOVERED_M)
        if surface_m <= _RECOVERED_M:
            surface_m = 0.0
        moved_n(surface_m)  # the last call determines the memories
        self._tried_surface = surface_m, False
        return state._replace(depth_m=min(depth_m, 0.0)), 0.0

    def _material_n(self, state: ContactState, force_n: float) -> float:
        """Add the forces of effects inside the material to that of the law [N]."""
        for material in self._material:
            if not material.acts_on_tip:
                force_n = material.contact_force_n(state, force_n)
        return force_n


class ComplianceObject:
    """Horizontal, frictionless surface with an upward force that depends on depth and rate.

    Args:
        engine: engine that moves the arm.
        law: contact law.
        surface_height_m: world height of the undeformed surface [m].

    Attributes:
        law: the present contact law; see `set_law`.
        surface_height_m: world height of the undeformed surface; see `move_surface` [m].
        is_engine_contact: whether the engine itself exerts the force.

    Raises:
        InputError: the law is an engine's own contact, which this engine does not have.
    """

    def __init__(self, engine: Engine, law: ObjectLaw, surface_height_m: float) -> None:
        self._engine = engine
        self.surface_height_m = surface_height_m
        self.set_law(law)

    def set_law(self, law: ObjectLaw) -> None:
        """Change the law from the next physics step on.

        Args:
            law: contact law.

        Raises:
            InputError: the engine has no such contact.
        """
        self._update_engine_surface(law, self.surface_height_m)
        self.law = law
        # Evaluated once instead of at each step, because it is slow.
        self.is_engine_contact = isinstance(law, EngineContact)

    def move_surface(self, height_m: float) -> None:
        """Change the height of the surface from the next physics step on.

        Args:
            height_m: world height of the undeformed surface [m].
        """
        self._update_engine_surface(self.law, height_m)
        self.surface_height_m = height_m

    def _update_engine_surface(self, law: ObjectLaw, height_m: float) -> None:
        self._engine.set_surface(law if isinstance(law, EngineContact) else None, height_m)


class TipContact:
    """Contact of one arm's tip with one object.

    The engine integrates by semi-implicit Euler: v(n+1) = v(n) + h a(n), x(n+1) = x(n) + h v(n+1), so its
    velocity belongs to the middle of the last step, half a step before its position. The law receives the
    rate at the time of the depth, (3 v(n) - v(n-1)) / 2. That makes contact accurate to the second order in h
    (leapfrog for the spring, Adams-Bashforth for the damper), and depth, rate and force of one state belong
    together.

    Args:
        engine: moves the arm.
        target: the object.
        step_s: length of a physics step h [s].
        effects: hidden effects; those of contact and tool act here.

    Attributes:
        depth_m: depth of the tip below the undeformed surface [m]; negative above it.
        rate_m_s: d(depth)/dt [m/s].
        force_n: force of the object on the tip, upwards [N].
        push_n: part of the force that the engine does not exert by itself; applied in the next step [N].
        tip_position_m: position of the tip frame in the world, shape (3,) [m].
    """

    def __init__(
        self, engine: Engine, target: ComplianceObject, step_s: float, effects: HiddenEffects
    ) -> None:
        self._engine = engine
        self._object = target
        self._step_s = step_s
        self._response = ObjectResponse(effects)
        self._last_speed_m_s: float | None = None

    def update(self, time_s: float) -> None:
        """Compute depth, rate and force in the arm's current state.

        Args:
            time_s: time of that state [s].
        """
        self.tip_position_m, velocity, self._quaternion = self._engine.tip_state()
        speed, last_speed = -velocity[2], self._last_speed_m_s
        self._last_speed_m_s = speed
        self.rate_m_s = speed if last_speed is None else 1.5 * speed - 0.5 * last_speed
        self.depth_m = self._object.surface_height_m - self.tip_position_m[2]
        engine_force_n = self._engine.surface_force_n() if self._object.is_engine_contact else None
        state = ContactState(time_s, self._step_s, self.depth_m, self.rate_m_s)
        self.force_n = self._response.force_n(self._object.law, state, engine_force_n)
        self.push_n = self.force_n - (engine_force_n or 0.0)

    def restart(self) -> None:
        """Reset the last step's speed, because the arm was placed elsewhere."""
        self._last_speed_m_s = None

    def compression_n(self, sensor_axis_tip: Sequence[float]) -> float:
        """Compute the force along the sensor axis, by the tilt of the tool; positive in compression [N].

        Args:
            sensor_axis_tip: unit vector in the tip frame along which the tool pushes.
        """
        x, y, z, w = self._quaternion
        a, b, c = sensor_axis_tip
        axis_up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
        return -axis_up * self.force_n
