"""Base models by family; add a class in this folder to register a new one."""

from palpate.estimation.base_model import BaseModel
from palpate.robot_io.registry import Registry

MODELS: Registry[BaseModel] = Registry("model", BaseModel, "palpate.estimation.models")
