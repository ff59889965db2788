"""Devices in the operator's hand: where the hand is, and the force that it feels."""
