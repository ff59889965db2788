"""The stand-in for hardware: PyBullet behind the interfaces of robot_io."""
