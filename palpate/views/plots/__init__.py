"""Plots as PNG, one figure a file."""

from palpate.views.plots.save import save_plots

__all__ = ["save_plots"]
