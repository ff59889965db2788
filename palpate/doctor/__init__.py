"""What `palpate doctor` looks at, one module per subject."""

from palpate.doctor.finding import Finding, Level
from palpate.doctor.subjects import examine_all

__all__ = ["Finding", "Level", "examine_all"]
