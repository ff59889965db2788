"""Whether a recording can be judged at all: lengths, units, times, sign, range, copies."""

from estimation.gate.gate import checklist, refuse, spoilt, usable

__all__ = ["checklist", "refuse", "spoilt", "usable"]
