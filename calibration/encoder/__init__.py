"""The joints' zeros: against a hard stop or a known pose."""
