"""A serial line as a pseudo terminal, with an emulated force sensor at its end."""

from abc import ABC, abstractmethod
from math import inf

from palpate.robot_io.drivers.serial_force.line import SerialForceSettings
from palpate.sim_backend.emulators.faults import Device, FaultKind, Faults, FrameWire
from palpate.sim_backend.emulators.hardware import Plant, PseudoTerminal


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
    range_n: float  # end of its range [N]
    _timer: StreamTimer
    _silent_until_s = -inf

    def __init__(self, settings: SerialForceSettings) -> None:
        self.sign = -1.0 if settings.reversed else 1.0

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Act on bytes from the host, unless the sensor is starting, and return the answer.

        Args:
            data: bytes from the host.
            now_s: emulator's clock [s].
        """
        return b"" if now_s < self._silent_until_s else self._process(data, now_s)

    def _process(self, data: bytes, now_s: float) -> bytes:
        """Act on bytes from the host and return the answer; most gauges only write."""
        return b""

    def due(self, now_s: float) -> bool:
        """Check whether a reading of a requested stream is due; each reading is due once.

        Args:
            now_s: emulator's clock [s].
        """
        return now_s >= self._silent_until_s and self._timer.due(now_s)

    @abstractmethod
    def reading(self, force_n: float) -> bytes:
        """Encode one reading of the stream as the bytes that the sensor sends.

        Args:
            force_n: force with the sensor's own sign [N]; NaN if there is none.
        """

    def restart(self, now_s: float, silent_s: float) -> None:
        """Return to the power-up state, after a silence.

        Args:
            now_s: emulator's clock [s].
            silent_s: duration of the silence [s].
        """
        self._silent_until_s = now_s + silent_s
        self._power_up(now_s)

    def _power_up(self, now_s: float) -> None:  # noqa: B027, a gauge need not have a memory
        """Reset the host's settings to those of power-up."""


class SensorWire(FrameWire[bytes]):
    """A line with one sensor at its end, and its faults.

    Faults of the sensor: readings dropped, late, corrupt, doubled, reordered; reboot; unplugged; stuck; not a
    number; saturated; reversed.
    """

    def __init__(self, sensor: SerialSensor, plant: Plant, faults: Faults | None = None) -> None:
        super().__init__(faults)
        self._sensor, self._plant = sensor, plant
        self._stuck_n: float | None = None

    def _corrupted(self, data: bytes) -> bytes:
        """Return a reading as it arrives after damage."""
        return self.faults.flip_a_bit(data)

    def send(self, now_s: float) -> None:
        trigger, name = self.faults.trigger, self._sensor.name
        if trigger(FaultKind.UNPLUG, name, now_s):
            self.close()
        if reboot := trigger(FaultKind.REBOOT, name, now_s):
            self._sensor.restart(now_s, reboot.delay_s)
        self._deliver_late(now_s)
        if self._sensor.due(now_s):
            reading = self._sensor.reading(self._sensor.sign * self._force_n(now_s))
            self._deliver(name, reading, now_s)

    def _force_n(self, now_s: float) -> float:
        trigger, name, limit_n = self.faults.trigger, self._sensor.name, self._sensor.range_n
        force_n = self._plant.force[0] if self._plant.force else float("nan")
        if trigger(FaultKind.STUCK, name, now_s):
            self._stuck_n = force_n if self._stuck_n is None else self._stuck_n
            return self._stuck_n
        self._stuck_n = None
        if trigger(FaultKind.NOT_A_NUMBER, name, now_s):
            return float("nan")
        if trigger(FaultKind.REVERSED, name, now_s):
            force_n = -force_n
        if trigger(FaultKind.SATURATED, name, now_s):
            return limit_n
        return min(max(force_n, -limit_n), limit_n)

    def _damaged(self, device: Device, frame: bytes, now_s: float) -> bytes:
        if self.faults.trigger(FaultKind.CORRUPT, device, now_s):
            frame = self._corrupted(frame)
        if self.faults.trigger(FaultKind.LOSE, device, now_s):
            frame = self.faults.lose_a_byte(frame)
        return frame


class PtyLine(SensorWire):
    """A pseudo terminal, `path` for the driver, and its sensor; see `SensorWire`.

    In lockstep, all bytes of an advance are written at its end, because the kernel may hand on two writes at
    different times. A sensor without a baud rate understands any [bit/s]. No byte overtakes another one.
    """

    stalls = True

    def __init__(
        self,
        sensor: SerialSensor,
        plant: Plant,
        faults: Faults | None = None,
        *,
        in_lock_step: bool = False,
        baud_rate: int | None = None,
    ) -> None:
        super().__init__(sensor, plant, faults)
        self._in_lock_step, self._unsent = in_lock_step, b""
        self._port = PseudoTerminal(baud_rate, kept_open=True)
        self.path = self._port.path

    def receive(self, now_s: float) -> None:
        if data := self._port.read():
            answer = self._sensor.receive(data, now_s)
            if answer and self._late:  # nothing overtakes on a line
                self._late.append((max(due_s for due_s, _ in self._late), answer))
            else:
                self._put(answer, now_s)

    def close(self) -> None:
        self._port.close()

    def _put(self, frame: bytes, now_s: float) -> None:
        self._unsent += frame
        if not self._in_lock_step:
            self.flush()

    def flush(self) -> None:
        unsent, self._unsent = self._unsent, b""
        self._port.write(unsent)
