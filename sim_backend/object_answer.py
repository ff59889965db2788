"""What an object answers to a motion of the tip: its law, with effects in its material, skin and tool."""

from collections.abc import Callable
from functools import partial

from sim_backend.contact_law import ContactLaw
from sim_backend.hooks import ContactEffect, ContactState, Effects, MaterialEffect, ToolEffect


class ObjectAnswer:
    """The force on the tip, with the memory of the effects."""

    def __init__(self, effects: Effects) -> None:
        self._memories: list[ContactEffect | ToolEffect] = [*effects.contact, *effects.tool]
        self._material = [effect for effect in effects.contact if isinstance(effect, MaterialEffect)]
        self._skin = [effect for effect in effects.contact if not isinstance(effect, MaterialEffect)]
        self._tools = effects.tool

    def force_n(self, law: ContactLaw, state: ContactState, by_engine_n: float | None = None) -> float:
        """The force that holds at this state [N]; the memories take it in.

        What the engine exerts [N], if it does, stands for the law: it answers to the tip's own motion only.
        """
        if not self._memories:
            return law.force_n(state.depth_m, state.rate_m_s) if by_engine_n is None else by_engine_n
        answer_n: Callable[[ContactState], float] = partial(self._object_n, law, by_engine_n)
        for tool in self._tools:
            answer_n = partial(tool.contact_force_n, surface_n=answer_n)
        force_n = answer_n(state)
        for memory in self._memories:
            memory.settle()
        return force_n

    def _object_n(self, law: ContactLaw, by_engine_n: float | None, state: ContactState) -> float:
        """What law and effects answer to a motion, which may be one that is only tried [N]."""
        for material in self._material:
            state = material.felt(state)
        if by_engine_n is not None:
            force_n = by_engine_n
        else:
            force_n = law.material_force_n(state.depth_m, state.rate_m_s) if state.depth_m > 0.0 else 0.0
        for material in self._material:
            force_n = material.contact_force_n(state, force_n)
        if force_n < 0.0 and not law.can_pull:
            force_n = 0.0
        for effect in self._skin:
            force_n = effect.contact_force_n(state, force_n)
        return force_n
