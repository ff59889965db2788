"""Stages of a model."""

from estimation.revision.revise import Revision, revise, revision_of, standings

__all__ = ["Revision", "revise", "revision_of", "standings"]
