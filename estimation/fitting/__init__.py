"""Fits a model to a channel."""
