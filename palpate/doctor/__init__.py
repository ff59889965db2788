"""What `palpate doctor` looks at: this machine, and an arm before it gets power."""

from palpate.doctor.machine import examine_all
from robot_io.examination import Finding, Level

__all__ = ["Finding", "Level", "examine_all"]
