"""The effects that palpate knows; a new one is one new file in this folder."""

from estimation.effect import Effect
from robot_io.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect", Effect, "estimation.effects")
