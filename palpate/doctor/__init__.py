"""What `palpate doctor` looks at: this machine, and an arm before it gets power."""

from palpate.doctor.finding import Finding, Level
from palpate.doctor.machine import examine_all

__all__ = ["Finding", "Level", "examine_all"]
