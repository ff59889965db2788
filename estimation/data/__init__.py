"""Channels from sessions and from data files."""
