"""Whether a recording can be judged at all: lengths, units, times, sign, range, copies."""

from estimation.gate.gate import refuse, spoilt, usable

__all__ = ["refuse", "spoilt", "usable"]
