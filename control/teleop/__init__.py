"""Teleoperation: the virtual object that the operator feels, messaging, and the follower's task."""
