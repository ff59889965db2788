"""Faults of force sensors on a serial line."""

import os
import threading
import tty

import pytest

from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers.serial_force import lorenz
from palpate.robot_io.drivers.serial_force.gauges import loadstar_stream
from palpate.robot_io.drivers.serial_force.line import SerialReader
from palpate.robot_io.drivers.serial_force.stream import ReadingStream
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators import FaultKind
from tests.wire.parts import BOTA, CUBEMARS, LINES, MARK10, NET_FT, ODRIVE

SENSORS = {
    "loadstar": (ODRIVE, ()),
    "lorenz": (CUBEMARS, ()),
    "force_lines": (ODRIVE, (LINES,)),
    "mark10": (ODRIVE, (MARK10,)),
    "bota": (ODRIVE, BOTA),
    "net_ft": (ODRIVE, NET_FT),
}


@pytest.fixture(params=SENSORS, ids=str)
def sensor(request, make_robot):
    """Any of the sensors, pressed with about 5 N."""
    path, changes = SENSORS[request.param]
    arm = make_robot(path, changes)
    arm.robot.configure()
    press(arm, 5.0)
    arm.ticks(10, None)
    return arm


def press(arm, force_n):
    world = arm.arm.plant.world
    world.held = True
    depth_m = force_n / world.object.law.stiffness_n_m
    world.object.move_surface(world.truth().tip_position_world_m[2] + depth_m)


def test_newest_reading_is_served_after_a_stall_of_the_line(make_robot):
    """A late reading holds back those behind it; all arrive together, and the force has risen meanwhile."""
    arm = make_robot(ODRIVE)
    arm.robot.configure()
    press(arm, 1.0)
    arm.ticks(100, None)
    served = 0
    for number in range(400):
        if number in (0, 200):
            arm.inject_fault("load_cell", FaultKind.DELAY, delay_s=0.1, times=1)
        press(arm, 1.0 + 0.02 * number)  # rises by 20 N/s
        measurement = arm.tick(None)
        if measurement.force_status is Status.OK:
            assert measurement.force_n == pytest.approx(arm.arm.plant.force[0], abs=0.3)
            served += 1
    assert 50 < served < 150  # two stalls of 50 readings


def test_silent_sensor_keeps_its_value_and_its_time(sensor):
    before = sensor.tick(None)
    sensor.inject_fault("load_cell", FaultKind.DROP)
    after = sensor.ticks(30, None)
    assert after.force_n == pytest.approx(before.force_n, abs=0.1)
    assert after.force_at_s <= before.force_at_s + 2.1e-3
    assert after.force_status is Status.STALE
    assert "no reading for" in sensor.problem


@pytest.mark.parametrize(
    ("path", "old", "new", "problem"),
    [
        (ODRIVE, "capacity_n: 100.0", "capacity_n: 200.0", "load cell of 100 N"),
        (CUBEMARS, "dimension_code: 3", "dimension_code: 4", "has dimension_code 3"),
        (CUBEMARS, "load_code: 100", "load_code: 50", "load_code 100"),
    ],
)
def test_another_sensor_than_stated_is_refused(make_robot, path, old, new, problem):
    arm = make_robot(path)
    stated = parse_robot_file(arm.text.replace(old, new), path)
    robot = build_robot(stated, DriverCatalog(), arm.clock)
    with pytest.raises(DeviceError, match=problem):
        robot.configure()


@pytest.mark.parametrize(("answer", "refused"), [("A", False), ("Tared", False), ("?", True)])
def test_zeroing_is_confirmed_or_refused(make_robot, answer, refused):
    """Interfaces differ in how they say yes; a no was once taken for a yes, and a plain yes for silence."""
    arm = make_robot(ODRIVE, [("capacity_n: 100.0}", "capacity_n: 100.0, tare: true}")])
    sensor = arm.sensor
    receive = sensor.receive
    sensor.receive = lambda data, now_s: (
        f"{answer}\r\n".encode() if data == b"CT0\r" else receive(data, now_s)
    )
    if refused:
        with pytest.raises(DeviceError, match="does not recognize CT0"):
            arm.robot.configure()
    else:
        arm.robot.configure()


def test_late_answer_to_a_ping_is_not_taken_for_another(make_robot):
    arm = make_robot(ODRIVE)
    receive = arm.sensor.receive
    arm.sensor.receive = lambda data, now_s: b"A\r\n\r\n" * bool(data.strip()) + receive(data, now_s)
    arm.robot.configure()
    assert arm.robot.force.examine()[0].text.startswith("DI-1000, counts in lb")


@pytest.fixture
def loadstar_line(make_robot):
    """Line of the force sensor of an arm; the sensor answers only when the simulated clock moves on."""
    arm = make_robot(ODRIVE)
    line = arm.robot.buses["load_cell"]
    line.configure()
    yield line
    line.close()


def test_request_is_sent_although_the_process_was_paused(loadstar_line, monkeypatch):
    """Whether a request was sent does not depend on how long the process waited for the processor."""
    write = os.write

    def write_late(file_descriptor, data):
        threading.Event().wait(0.3)
        return write(file_descriptor, data)

    monkeypatch.setattr(os, "write", write_late)
    loadstar_line.write(b"ID\r")


def test_blocked_output_is_a_failure(loadstar_line):
    with pytest.raises(DeviceError, match=r"be written to \(took \d+ of \d+ bytes; its output is blocked"):
        loadstar_line.write(b"x" * 10_000_000)


def test_request_to_a_port_that_is_gone_states_the_reason(loadstar_line):
    loadstar_line._port.close()
    with pytest.raises(DeviceError, match=r"cannot be written to \(.*port that is not open"):
        loadstar_line.write(b"ID\r")


# The reader alone, on a pseudo terminal.


@pytest.fixture
def terminal():
    """Both ends of a pseudo terminal: what the sensor writes to, and what the reader reads from."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)
    open_ends = {master, slave}
    yield master, slave, open_ends
    for end in open_ends:
        os.close(end)


def test_thread_reads_and_reports_a_lost_port(terminal):
    master, slave, open_ends = terminal
    clock = MonotonicClock()
    reader = SerialReader(slave, loadstar_stream(1.0, 100.0), clock, 1e4)
    reader.start()
    try:
        os.write(master, b"\r\n")
        for i in range(1000):
            os.write(master, b"%12.4f\r\n" % (i % 100))
            if reader.newest is not None:
                break
            threading.Event().wait(0.005)
        assert reader.newest is not None
        assert 0.0 <= clock.now_s() - reader.newest.arrived_at_s < 10.0
        os.close(master)
        open_ends.remove(master)
        for _ in range(1000):
            if reader.failure:
                break
            threading.Event().wait(0.005)
        assert "port" in reader.failure
    finally:
        reader.stop()
    reader.stop()


def test_decoder_defect_ends_the_thread_with_a_report(terminal):
    master, slave, _ = terminal

    class Broken(ReadingStream):
        def feed(self, data):
            raise ZeroDivisionError("a defect")

    reader = SerialReader(slave, Broken(), MonotonicClock(), 1.0)
    reader.start()
    os.write(master, b"x")
    for _ in range(1000):
        if reader.failure:
            break
        threading.Event().wait(0.005)
    reader.stop()
    assert reader.failure == "reading failed (ZeroDivisionError: a defect)"


@pytest.mark.parametrize(
    ("path", "delay_s", "ages_ms"),
    [
        (CUBEMARS, "0.0", {1}),  # a sample of the stream counts once the next counter has come
        (CUBEMARS, "0.002", {3}),
        (ODRIVE, "0.0", {0, 1}),  # 500 lines a second, each read in the tick in which it comes
        (ODRIVE, "0.002", {2, 3}),
    ],
)
def test_force_age_includes_the_sensor_delay(make_robot, path, delay_s, ages_ms):
    arm = make_robot(path, [("delay_s: 0.0 ", f"delay_s: {delay_s} ")]).start()
    ticks = [arm.tick() for _ in range(20)]
    assert {round(1e3 * (one.time_s - one.force_at_s), 3) for one in ticks} == ages_ms


STRANGER = lorenz.encode_telegram(lorenz.Telegram(lorenz.LorenzCommand.HELLO, 255, 9, b"\x01"))
SILENT = {"receive": lambda data, now_s: b""}


@pytest.mark.parametrize(
    ("path", "changes", "spoil", "problem"),
    [
        (ODRIVE, [MARK10], {"unit": "LBIN"}, "unit 'lbFin' is not a known unit of force"),
        (ODRIVE, [MARK10], {"unknown": ("FULL",)}, r"'\*10 illegal command' to a request for its model"),
        (ODRIVE, [MARK10], SILENT, "no gauge gives an answer; check port and baud rate"),
        (ODRIVE, [], {"_unit": "psi"}, "unit 'psi' is not a known unit"),
        (ODRIVE, [], SILENT, "no DI-100 or DI-1000 answers"),
        # From another sensor.
        (CUBEMARS, [], {"receive": lambda data, now_s: STRANGER}, "no answer to HELLO; check port"),
        (
            *(CUBEMARS, [], {"receive": lambda data, now_s: STRANGER[:-1] + b"\0"}),
            r"no answer to HELLO \(\d+ damaged telegrams\); check port",
        ),
    ],
)
def test_unusable_sensor_is_refused(make_robot, path, changes, spoil, problem):
    arm = make_robot(path, changes)
    vars(arm.sensor).update(spoil)
    with pytest.raises(DeviceError, match=problem):
        arm.robot.configure()


@pytest.mark.parametrize(
    ("sensor", "unknown"),
    [
        (("capacity_n: 100.0}", "capacity_n: 100.0, reversed: true}"), ()),
        (MARK10, ("IPOL", "OPOL")),  # a gauge without commands for signs
    ],
)
def test_reversed_or_unsigned_sensor_shows_a_press(make_robot, sensor, unknown):
    arm = make_robot(ODRIVE, [sensor])
    arm.sensor.unknown = unknown
    arm.robot.configure()
    press(arm, 5.0)
    assert arm.ticks(10, None).force_n == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("before", [b"  \r\n", b"x" * 300 + b"\r\n"], ids=["blanks", "too long"])
def test_line_without_words_before_an_answer_is_no_answer(make_robot, before):
    arm = make_robot(ODRIVE, [MARK10])
    sensor = arm.sensor
    obey, reading = sensor._execute, sensor.reading
    sensor._execute = lambda command, now_s: before * (command == "RM") + obey(command, now_s)
    sensor.reading = lambda force_n: before + reading(force_n)
    arm.robot.configure()
    (found,) = arm.robot.force.examine()
    assert found.text.startswith("M7-50, reads in lbF")


def test_gauge_switched_to_another_unit_is_named(make_robot):
    arm = make_robot(ODRIVE, [MARK10])
    arm.robot.configure()
    arm.ticks(10, None)
    arm.sensor.unit = "N"
    arm.ticks(20, None)
    assert "the gauge reads in N; when configured, it read in lbF" in arm.problem


def test_lost_answer_is_requested_again_at_once(make_robot):
    """The gauge was left alone for 0.35 s, and the arm stopped."""
    arm = make_robot(ODRIVE, [MARK10])
    arm.robot.configure()
    press(arm, 5.0)
    arm.ticks(600, None)
    for _ in range(5):
        arm.inject_fault("load_cell", FaultKind.DROP, times=1)
        measurements = [arm.tick(None) for _ in range(20)]
        assert max(one.time_s - one.force_at_s for one in measurements) < 9.5e-3
        assert {one.force_status for one in measurements} <= {Status.OK, Status.STALE}
        assert measurements[-1].force_n == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("late_ms", [4.2, 60.0, 130.0])
def test_answer_is_as_old_as_its_request(make_robot, late_ms):
    """What comes later than the driver waits for belongs to no younger question."""
    arm = make_robot(ODRIVE, [MARK10])
    arm.robot.configure()
    arm.ticks(10, None)
    arm.inject_fault("load_cell", FaultKind.DELAY, delay_s=late_ms * 1e-3)
    struck_s = arm.clock.now_s()
    for _ in range(900):
        measurement = arm.tick(None)
        if measurement.force_at_s > struck_s:
            assert measurement.time_s - measurement.force_at_s >= late_ms * 1e-3
