"""What the CAN and serial drivers add to the time that python-can itself takes, per tick.

Run: python benchmarks/can_bus.py [ticks, default 3000]

Three emulated motors and a force sensor in lock-step, so that everything has arrived when the tick begins.
Timed are palpate's whole read and write, and beside it bare python-can: receiving and sending as many frames
on a bus of the same kind, with nothing done to them. "Added" is the difference of the medians.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np

from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.robot import build_robot
from robot_io.robot_file import load_robot_file
from robot_io.types import Command
from sim_backend.emulators.wiring import wire_up
from sim_backend.scenario import load_scenario

ROBOTS = Path(__file__).parents[1] / "robots"
TICK_S = 1e-3
FRAMES_IN = {"odrive": 6, "cubemars": 3}  # estimates and torques of three axes; three answers
ZERO = Command(np.zeros(3))


def timed(ticks: int, prepare: Callable[[], None], tick: Callable[[], None]) -> np.ndarray:
    """Wall time of each tick [us]; what `prepare` takes is not counted."""
    times = np.zeros(ticks)
    for i in range(ticks):
        prepare()
        before_ns = time.perf_counter_ns()
        tick()
        times[i] = (time.perf_counter_ns() - before_ns) / 1e3
    return times


def palpate(name: str, ticks: int) -> np.ndarray:
    """Reading and commanding the whole robot."""
    clock = SimulatedClock()
    arm = wire_up(load_robot_file(ROBOTS / f"{name}_3dof.yaml"), load_scenario("default"), clock)
    arm.plant.world.held = True

    def tick() -> None:
        robot.read(clock.now_s())
        robot.write(ZERO, clock.now_s())

    with build_robot(arm.robot_file, DriverCatalogue(), clock) as robot:
        robot.activate()
        times = timed(ticks, lambda: clock.sleep_until(clock.now_s() + TICK_S), tick)
    arm.bench.close()
    return times


def bare(name: str, ticks: int) -> np.ndarray:
    """As many frames through python-can alone."""
    channel, message = f"bare-{name}", can.Message(arbitration_id=0x29, data=bytes(8), is_extended_id=False)

    def prepare() -> None:
        while devices.recv(timeout=0) is not None:
            pass
        for _ in range(FRAMES_IN[name]):
            devices.send(message)

    def tick() -> None:
        while bus.recv(timeout=0) is not None:
            pass
        for _ in range(3):
            bus.send(message)

    with (
        can.Bus(interface="virtual", channel=channel) as bus,
        can.Bus(interface="virtual", channel=channel) as devices,
    ):
        return timed(ticks, prepare, tick)


def main() -> None:
    """Measure both and print a table."""
    ticks = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    print(f"{'robot':<10}{'who':<18}{'p50':>8}{'p99':>8}{'p99.9':>8}{'added p50':>11} [us]")
    for name in FRAMES_IN:
        alone = bare(name, ticks)
        for who, times in (("palpate, with force", palpate(name, ticks)), ("python-can alone", alone)):
            p50, p99, p999 = np.percentile(times, [50, 99, 99.9])
            print(f"{name:<10}{who:<20}{p50:>6.0f}{p99:>8.0f}{p999:>8.0f}{p50 - np.median(alone):>11.0f}")


if __name__ == "__main__":
    main()
