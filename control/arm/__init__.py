"""The arm itself: its kinematics and dynamics, from URDF or DH table."""
