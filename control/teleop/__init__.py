"""Teleoperation: the virtual object that the operator feels, and couplings between leader and follower."""
