"""Kinematics and dynamics of the arm, from URDF or DH table."""
