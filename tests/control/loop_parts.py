"""Parts for loop tests: the mock arm with fault hooks, a log in memory, a task."""

from collections.abc import Callable

import numpy as np

from palpate.control.loop.task import Phase, TaskEvent, TaskOutput
from palpate.control.loop.tick_record import tick_stream
from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.guard import Guard
from palpate.robot_io.types import Command
from tests.mock_robot import ROBOT_YAML, build_mock_robot, mock_bus, mock_robot_file

JOINTS = 3
RATE_HZ = 1000.0
AGE_LIMIT_S = 0.005
STOP_TIME_S = 0.2
TICK = tick_stream(JOINTS).dtype  # making it takes longer than the rest of a tick
WIDTHS = [column.width for column in tick_stream(JOINTS).columns]


class MockArm:
    """The mock robot, configured, with its guard; what it was sent is kept, and its bus can be made to fail.

    Args:
        clock: the robot's clock; simulated unless given.
        age_limit_s: of all samples; long ones keep a busy machine from tripping the guard.
    """

    def __init__(self, clock: Clock | None = None, age_limit_s: float = AGE_LIMIT_S) -> None:
        text = ROBOT_YAML.replace(f"_age_s: {AGE_LIMIT_S}", f"_age_s: {age_limit_s}")
        robot_file = mock_robot_file(text)
        self.clock = clock or SimulatedClock()
        self.robot = build_mock_robot(self.clock, text)
        self.guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
        self.bus = mock_bus(self.robot)
        self.plant, self.faults = self.bus.plant, self.bus.faults
        self.sent_nm: list[np.ndarray] = []
        self.on_poll: Callable[[], None] = lambda: None
        self.on_flush: Callable[[], None] = lambda: None
        self._poll, self._flush = self.bus.poll, self.bus.flush
        self.bus.poll, self.bus.flush = self._hooked_poll, self._hooked_flush
        self.robot.configure()

    def _hooked_poll(self, deadline_s: float) -> None:
        self.on_poll()
        self._poll(deadline_s)

    def _hooked_flush(self, deadline_s: float) -> None:
        self.on_flush()
        self._flush(deadline_s)
        self.sent_nm.append(self.plant.torque_nm)


class MemoryLog:
    """A log that keeps everything, and fails on demand."""

    def __init__(self) -> None:
        self.records: list[np.void] = []
        self.events: list[tuple[float, str, str]] = []
        self.dropped = 0
        self.failure: str | None = None
        self.error: Exception | None = None

    def append(self, stream_name, record) -> None:
        assert stream_name == "tick"
        if self.error:
            raise self.error
        assert [getattr(value, "size", 1) for value in record] == WIDTHS
        self.records.append(np.array(record, TICK)[()])

    def event(self, time_s, kind, text, data=None) -> None:
        self.events.append((time_s, kind, text))

    def column(self, name: str) -> np.ndarray:
        return np.array([record[name] for record in self.records])

    def texts(self, kind: str) -> list[str]:
        return [text for _, event_kind, text in self.events if event_kind == kind]


class SwingTask:
    """Moves the joints with a constant torque, and may fail or end at a given tick."""

    def __init__(
        self, *, done_at: int | None = None, fail_at: int | None = None, torque_nm: float = 0.1
    ) -> None:
        self.done_at, self.fail_at, self.torque_nm = done_at, fail_at, torque_nm
        self.steps = 0
        self.dts_s: list[float] = []
        self.started_from = None

    def start(self, measurement) -> None:
        self.started_from = measurement

    def step(self, measurement, dt_s) -> TaskOutput:
        self.steps += 1
        self.dts_s.append(dt_s)
        if self.steps == self.fail_at:
            raise ZeroDivisionError("the controller has a bug")
        zeros = np.zeros(3)
        return TaskOutput(
            command=Command(np.full(JOINTS, self.torque_nm)),
            reference_position_rad=measurement.joint_position_rad,
            reference_velocity_rad_s=measurement.joint_velocity_rad_s,
            tip_position_world_m=zeros,
            tip_velocity_world_m_s=zeros,
            press_direction_world=np.array([0.0, 0.0, -1.0]),
            desired_force_n=2.0,
            phase=Phase.LOADING,
            run=4,
            done=self.steps == self.done_at,
            events=(TaskEvent("touch", "touched"),) if self.steps == 3 else (),
        )
