"""Cuts a stream of bytes into what a sensor sends as one: lines here, binary samples in `lorenz`."""

from typing import Protocol

MAX_LINE = 200  # bytes; a longer one is noise


class Stream(Protocol):
    """Makes force samples out of bytes, in any portions. Damaged ones are counted and left out."""

    @property
    def rejected(self) -> int:
        """How much was not a sample."""

    def feed(self, data: bytes) -> list[float]:
        """Samples that are complete now, oldest first [N], in the sensor's own sign."""


class LineSplitter:
    """Cuts at CR and LF, whichever come; empty lines vanish.

    Attributes:
        dropped: lines that were too long to be one.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._skipping = False  # until the end of a line whose beginning was not seen or was too long
        self.dropped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Lines that are complete now, without their ends."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if lines and self._skipping:
            lines, self._skipping = lines[1:], False
        if len(self._rest) > MAX_LINE:
            self._rest, self._skipping = b"", True
            self.dropped += 1
        kept = [line for line in lines if line and len(line) <= MAX_LINE]
        self.dropped += sum(len(line) > MAX_LINE for line in lines)
        return kept

    def resynchronise(self) -> None:
        """Forget what is incomplete, and the rest of it that is still to come."""
        self._rest, self._skipping = b"", True
