"""Least squares, how large the noise is, and how sure a result."""
