"""Fit models to channels by bounded variable projection, and assess the residual."""
