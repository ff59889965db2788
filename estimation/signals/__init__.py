"""Signals derived from a channel, run by run."""
