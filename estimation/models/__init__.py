"""Base models, one per file."""

from estimation.models.registry import MODELS

__all__ = ["MODELS"]
