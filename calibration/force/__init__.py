"""The force sensor, from known weights or a reference: plateaus, fit, weighing on the robot."""
