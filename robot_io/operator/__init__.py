"""Devices in the operator's hand: they read its position and render forces."""
