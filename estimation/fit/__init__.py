"""Fit models to channels by bounded variable projection, and check their residuals."""
