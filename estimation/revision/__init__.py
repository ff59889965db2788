"""Stages of a model."""

from estimation.revision.revise import Revision, revise

__all__ = ["Revision", "revise"]
