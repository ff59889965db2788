"""Signals derived from a channel, computed run by run."""
