"""Physical effects, grouped by kind of physics; add a class in this folder to register a new effect."""

from palpate.estimation.effect import Effect
from palpate.robot_io.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect", Effect, "palpate.estimation.effects")
