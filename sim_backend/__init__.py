"""The simulated robot: an arm, an object and sensors in a physics engine, as robot_io's devices."""

from pathlib import Path

ARMS = Path(__file__).parent / "arms"  # folder of the simulated arms' robot files
