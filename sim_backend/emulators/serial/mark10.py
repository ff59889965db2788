"""A Mark-10 force gauge, written from the command set (GCL2) in its user's guide: it answers when asked."""

import math

from sim_backend.emulators.serial.pty_line import SerialSensor

_UNITS = {  # command, what it writes behind a reading, and what that is [N], or [N m]
    "N": ("N", 1.0),
    "LB": ("lbF", 4.4482216152605),
    "KG": ("kgF", 9.80665),
    "G": ("gF", 0.00980665),
    "MN": ("mN", 1e-3),
    "LBIN": ("lbFin", 1.0),
}
_SILENT = ("AOUT", "AOFF", "IPOL", "OPOL", "FULL", "NUM", "CUR")  # settings that are not answered


class EmulatedMark10(SerialSensor):
    """One gauge; it reads a tenth beyond its capacity [N], and takes `answer_s` to answer [s].

    Attributes:
        unit: command of the unit that it reads in.
        unknown: commands that it does not know.
    """

    unit, unknown = "LB", ()

    def __init__(self, capacity_n: float, answer_s: float = 1.5e-3) -> None:
        self.range_n, self._answer_s = 1.1 * capacity_n, answer_s
        self._input, self._due_s = b"", math.inf

    def hear(self, data: bytes, now_s: float) -> bytes:
        if now_s < self._silent_until_s:
            return b""
        *commands, self._input = (self._input + data).replace(b"\n", b"").split(b"\r")
        return b"".join(self._obey(command.decode("ascii", "replace"), now_s) for command in commands)

    def _obey(self, command: str, now_s: float) -> bytes:
        if command == "?C":
            self._due_s = now_s + self._answer_s
        elif command == "RM":
            return b"M7-50\r\n"
        elif command.rstrip("0123456789") in self.unknown or not command:
            return b"*10\r\n" if command else b""
        elif command in _UNITS:
            self.unit = command
        elif command.rstrip("0123456789") not in _SILENT:
            return b"*10\r\n"
        return b""

    def due(self, now_s: float) -> bool:
        """See `SerialSensor.due`: once for each time that it was asked."""
        is_due = self._due_s <= now_s + 1e-9 and now_s >= self._silent_until_s
        self._due_s = math.inf if is_due else self._due_s
        return is_due

    def reading(self, force_n: float) -> bytes:
        written, newtons = _UNITS[self.unit]
        value = f"{force_n / newtons:.3f}" if math.isfinite(force_n) else "---"
        return f"{value} {written}\r\n".encode()

    def restart(self, now_s: float, silent_s: float) -> None:
        self._input, self._due_s = b"", math.inf
        super().restart(now_s, silent_s)
