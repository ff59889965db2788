"""Rerun recordings: of a session with its arm, and of a model that grows revision by revision."""
