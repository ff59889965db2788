"""Physical effects in families by kind of physics; a new effect is one new class here."""

from estimation.effect import Effect
from robot_io.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect", Effect, "estimation.effects")
