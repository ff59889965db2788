"""Least squares, noise levels, residual correlation and uncertainty of results."""
