"""Physical effects in families by kind of physics; a new effect is one new class here."""

from palpate.estimation.effect import Effect
from palpate.robot_io.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect", Effect, "palpate.estimation.effects")
