"""Physical effects, one per file."""

from estimation.effects.registry import EFFECTS

__all__ = ["EFFECTS"]
