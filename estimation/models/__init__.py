"""Base models by family; a new one is one new class here."""

from estimation.base_model import BaseModel
from robot_io.registry import Registry

MODELS: Registry[BaseModel] = Registry("model", BaseModel, "estimation.models")  # type: ignore[type-abstract]
