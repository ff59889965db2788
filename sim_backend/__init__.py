"""The simulated robot: an arm, an object and sensors in a physics engine, as robot_io's devices."""
