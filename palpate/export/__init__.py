"""A fitted model as a simulated world."""

from palpate.export.scenario import Export, export_scenario

__all__ = ["Export", "export_scenario"]
