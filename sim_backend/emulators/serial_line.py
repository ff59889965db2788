"""A serial line as a pseudo terminal, with an emulated force sensor at its end."""

import errno
import os
import select
import tty
from abc import ABC, abstractmethod
from math import inf

from palpate.sim_backend.emulators.hardware import EmulatedWire, Plant, baud_rate_matches

_RANGE_N = 1e3  # reading of a saturated sensor without its own range


class StreamTimer:
    """Schedules the readings of a stream at a steady rate; missed readings are not repeated.

    The first one is due a period after the start. `passed` is the number of periods between the last two due
    readings, more than one if some were missed.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next_s = inf
        self.passed = 1

    @property
    def running(self) -> bool:
        """Whether the stream is on."""
        return self._next_s < inf

    def start(self, now_s: float) -> None:
        """Start the stream.

        Args:
            now_s: emulator's clock [s].
        """
        self._next_s = now_s + self._period_s

    def stop(self) -> None:
        """Stop the stream."""
        self._next_s = inf

    def due(self, now_s: float) -> bool:
        """Check whether a reading is due; each is due once.

        Args:
            now_s: emulator's clock [s].
        """
        if now_s < self._next_s - 1e-9:
            return False
        self.passed = 1 + int((now_s - self._next_s + 1e-9) / self._period_s)
        self._next_s += self.passed * self._period_s
        return True


class SerialSensor(ABC):
    """Emulated sensor at the end of the line."""

    name = "force"
    sign = 1.0
    range_n: float = _RANGE_N  # end of its range [N]
    _timer: StreamTimer

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Act on bytes from the host; most gauges only write.

        Args:
            data: bytes from the host.
            now_s: emulator's clock [s].

        Returns:
            The answer; may be empty.
        """
        return b""

    def due(self, now_s: float) -> bool:
        """Check whether a reading of a requested stream is due; each reading is due once.

        Args:
            now_s: emulator's clock [s].
        """
        return self._timer.due(now_s)

    @abstractmethod
    def reading(self, force_n: float) -> bytes:
        """Encode one reading of the stream.

        Args:
            force_n: force with the sensor's own sign [N]; NaN if there is none.

        Returns:
            The bytes that the sensor sends.
        """


class SensorWire(EmulatedWire):
    """A line with one sensor at its end."""

    def __init__(self, sensor: SerialSensor, plant: Plant) -> None:
        self._sensor, self._plant = sensor, plant

    def send(self, now_s: float) -> None:
        if self._sensor.due(now_s):
            self._put(self._sensor.reading(self._sensor.sign * self._force_n()), now_s)

    def _force_n(self) -> float:
        """Return the force within the sensor's range [N]; NaN before the plant's first sample."""
        force_n = self._plant.force[0] if self._plant.force else float("nan")
        return min(max(force_n, -self._sensor.range_n), self._sensor.range_n)

    @abstractmethod
    def _put(self, frame: bytes, now_s: float) -> None:
        """Send bytes to the host, if it is connected."""


class PtyLine(SensorWire):
    """A pseudo terminal, `path` for the driver, and its sensor; see `SensorWire`.

    In lockstep, all bytes of an advance are written at its end, because the kernel may hand on two writes at
    different times. A sensor without a baud rate understands any [bit/s].
    """

    def __init__(
        self,
        sensor: SerialSensor,
        plant: Plant,
        *,
        in_lock_step: bool = False,
        baud_rate: int | None = None,
    ) -> None:
        super().__init__(sensor, plant)
        self._in_lock_step, self._baud_rate = in_lock_step, baud_rate
        self._unsent = b""
        self._master: int | None
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        self.path = os.ttyname(self._slave)

    def receive(self, now_s: float) -> None:
        if self._master is None or not self._poll.poll(0):  # faster than a read that fails
            return
        try:
            data = os.read(self._master, 65536)
        except OSError:  # nothing has arrived, or the other end is not open
            return
        if data and baud_rate_matches(self._master, self._baud_rate):
            self._put(self._sensor.receive(data, now_s), now_s)

    def close(self) -> None:
        """See `EmulatedWire.close`: the host sees a port that has gone."""
        if self._master is not None:
            master, self._master = self._master, None
            os.close(self._slave)
            os.close(master)

    def _put(self, frame: bytes, now_s: float) -> None:
        self._unsent += frame
        if not self._in_lock_step:
            self.flush()

    def flush(self) -> None:
        unsent, self._unsent = self._unsent, b""
        if self._master is None or not unsent:
            return
        try:
            os.write(self._master, unsent)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):  # the host reads too slowly, or not at all
                raise
