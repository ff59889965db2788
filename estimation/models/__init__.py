"""Base models by family; a new one is one new class here."""

from palpate.estimation.base_model import BaseModel
from palpate.robot_io.registry import Registry

MODELS: Registry[BaseModel] = Registry("model", BaseModel, "palpate.estimation.models")
