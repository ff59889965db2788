"""Whether a recording can be judged at all: lengths, units, times, sign, range, copies."""

from estimation.gate.gate import checklist, of_runs_left, refuse, spoilt, usable

__all__ = ["checklist", "of_runs_left", "refuse", "spoilt", "usable"]
