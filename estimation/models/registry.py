"""The base models that palpate knows; a new one is one new file in this folder."""

from estimation.base_model import BaseModel
from robot_io.registry import Registry

MODELS: Registry[BaseModel] = Registry("model", BaseModel, "estimation.models")  # type: ignore[type-abstract]
