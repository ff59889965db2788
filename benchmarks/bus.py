"""What the Dynamixel drivers add to the time that the bus itself takes, beside the vendor's SDK.

Run: python benchmarks/bus.py [ticks, default 3000]

Three emulated servos and a force sensor run in a process of their own, on pseudo terminals, at 4 Mbit/s in
real time. In each tick of 1 ms all joints are read and commanded, in three ways, each with the plain and the
fast sync read: the same bytes written and read with system calls and nothing else (that is the bus and the
emulator); palpate's whole robot with its force sensor; and the SDK's group sync read with getData for each
value, and its group sync write. "Added" is the median beyond the bare bytes; CPU time is that of the calling
thread.
"""

import multiprocessing
import os
import select
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from robot_io.clock import MonotonicClock
from robot_io.driver import DriverCatalogue
from robot_io.drivers.dynamixel import protocol
from robot_io.drivers.dynamixel.feedback import FEEDBACK_SIZE, PADDING
from robot_io.robot import build_robot
from robot_io.robot_file import RobotFile, load_robot_file, parse_robot_file
from robot_io.types import Command, Status
from sim_backend.emulators.wiring import wire_up
from sim_backend.scenario import load_scenario

ROBOT = Path(__file__).parents[1] / "robots" / "dynamixel_3dof.yaml"
IDS = (1, 2, 3)
ADDRESS, GOAL = 224 + PADDING, 102  # first byte of the feedback block; goal current
TICK_S = 1e-3
ANSWER = {"plain": 3 * (11 + FEEDBACK_SIZE), "fast": 8 + 3 * (4 + FEEDBACK_SIZE)}  # bytes, nothing stuffed
ZEROS = protocol.sync_write(GOAL, dict.fromkeys(IDS, b"\0\0"))


def emulate(pipe: Connection) -> None:
    """Run the emulated devices until the other side says something."""
    arm = wire_up(load_robot_file(ROBOT), load_scenario("default"), MonotonicClock())
    arm.bench.start()
    pipe.send(arm.robot_file.text)
    pipe.recv()
    arm.bench.close()


Times = tuple[np.ndarray, np.ndarray, int]


def measure(ticks: int, tick: Callable[[], bool]) -> Times:
    """Wall and CPU time of each tick [us], and how many brought no new samples."""
    clock = MonotonicClock()
    wall, cpu, lost, next_s = [], [], 0, clock.now_s()
    for _ in range(ticks):
        next_s = max(next_s + TICK_S, clock.now_s())
        clock.sleep_until(next_s)
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        lost += not tick()
        wall.append(time.perf_counter() - wall_s)
        cpu.append(time.thread_time() - cpu_s)
    return 1e6 * np.array(wall), 1e6 * np.array(cpu), lost


def bare(port: PortHandler, way: str) -> Callable[[], bool]:
    """The same bytes with nothing around them."""
    fd, size = port.ser.fileno(), ANSWER[way]
    ask = protocol.fast_sync_read if way == "fast" else protocol.sync_read
    request = ask(ADDRESS, FEEDBACK_SIZE, IDS)

    def tick() -> bool:
        os.write(fd, request)
        received = 0
        while received < size and select.select([fd], [], [], 0.1)[0]:
            received += len(os.read(fd, 4096))
        os.write(fd, ZEROS)
        return received >= size

    return tick


def sdk(port: PortHandler, way: str) -> Callable[[], bool]:
    """The SDK's group reads and writes."""
    packets = PacketHandler(2.0)
    reading = GroupSyncRead(port, packets, ADDRESS, FEEDBACK_SIZE)
    writing = GroupSyncWrite(port, packets, GOAL, 2)
    for servo_id in IDS:
        reading.addParam(servo_id)
        writing.addParam(servo_id, [0, 0])
    read = reading.fastSyncRead if way == "fast" else reading.txRxPacket

    def tick() -> bool:
        good = read() == COMM_SUCCESS
        for servo_id in IDS:
            for offset, size in ((3, 2), (5, 4), (9, 4)):
                reading.getData(servo_id, ADDRESS + offset, size)
            writing.changeParam(servo_id, [0, 0])
        writing.txPacket()
        return bool(good)

    return tick


def palpate(robot_file: RobotFile, ticks: int) -> Times:
    """The whole robot: read, with the force sensor, and write."""
    clock = MonotonicClock()
    robot = build_robot(robot_file, DriverCatalogue(), clock)
    zero = Command(np.zeros(3))

    def tick() -> bool:
        start_s = clock.now_s()
        measurement = robot.read(start_s + TICK_S)
        robot.write(zero, start_s + TICK_S)
        return measurement.encoder_status is Status.OK

    with robot:
        robot.activate()
        return measure(ticks, tick)


def main() -> None:
    """Measure all ways, and print a line each."""
    ticks = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    emulator = context.Process(target=emulate, args=(there,), daemon=True)
    emulator.start()
    text = here.recv()
    results = {}
    for way in ("plain", "fast"):
        said = text.replace("fast_sync_read: true", f"fast_sync_read: {str(way == 'fast').lower()}")
        robot_file = parse_robot_file(said, ROBOT)
        results[way, "palpate, with force"] = palpate(robot_file, ticks)
        motors = robot_file.buses["motors"].settings
        port = PortHandler(motors["port"])
        port.setBaudRate(motors["baud_rate"])  # opens it too; servos do not hear any other speed
        results[way, "bare bytes"] = measure(ticks, bare(port, way))
        results[way, "dynamixel-sdk"] = measure(ticks, sdk(port, way))
        port.closePort()
    here.send("end")
    emulator.join(5)
    print(
        f"{'read':<7}{'who':<22}{'p50':>9}{'p99':>9}{'p99.9':>9}{'added p50':>11}{'CPU p50':>9}{'lost':>6} us"
    )
    for (way, who), (wall, cpu, lost) in results.items():
        p50, p99, p999 = np.percentile(wall, [50, 99, 99.9])
        added = p50 - np.median(results[way, "bare bytes"][0])
        print(
            f"{way:<7}{who:<22}{p50:>9.0f}{p99:>9.0f}{p999:>9.0f}{added:>11.0f}{np.median(cpu):>9.0f}{lost:>6}"
        )


if __name__ == "__main__":
    main()
