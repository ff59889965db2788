"""Teleoperation as it is run: follower with its arm, leader with its haptic process, and both at once."""
