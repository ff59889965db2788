"""Least squares, noise levels, and uncertainty of results."""
