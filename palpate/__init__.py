"""The face: command line, Rerun views, reports. Nothing imports it."""
