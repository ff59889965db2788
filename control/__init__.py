"""Rigid body, controllers, the real-time loop and the probing task."""
