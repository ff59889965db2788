"""A test setup for each operator device, which moves it, presses its button and unplugs it."""

import atexit
import ctypes
import os
import pty
import select
import shutil
import struct
import subprocess
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from palpate.control.teleop.leader_arm import build_operator_device
from palpate.robot_io.clock import MonotonicClock, SimulatedClock
from tests.mock_robot import mock_bus, write_mock_files


class OperatorSetup:
    """One device; `move` brings it upwards, `press` holds its button, `unplug` takes it away."""

    clock_type = SimulatedClock
    oldest_s = 0.1  # of a fresh sample

    def __init__(self, folder: Path) -> None:
        self.folder, self.clock = folder, self.clock_type()
        self.device = build_operator_device(self.name, self.settings(), self.clock)

    def settings(self):
        return {}

    def wait(self, duration_s):
        self.clock.sleep_until(self.clock.now_s() + duration_s)

    def close(self):
        self.device.close()

    def unplug(self):
        pytest.skip("nothing that could be unplugged")


class Scripted(OperatorSetup):
    name = "scripted"

    def settings(self):
        far = {"time_s": 2.0, "position_world_m": [0, 0, 0.2], "select": True}
        return {"path": [{"time_s": 0.0, "position_world_m": [0, 0, 0]}, far]}

    def move(self):
        self.wait(1.0)

    def press(self):
        self.wait(2.5)


class Pipe(OperatorSetup):
    """A device file that the test writes to."""

    def settings(self):
        self.path = self.folder / "port"
        if not self.path.exists():
            os.mkfifo(self.path)
        self.writer = os.open(self.path, os.O_RDWR)
        return {"port": str(self.path)}

    def send(self, record):
        os.write(self.writer, record)
        self.wait(0.3)

    def unplug(self):
        os.close(self.writer)
        self.writer = None

    def close(self):
        super().close()
        if self.writer is not None:
            os.close(self.writer)


class GamepadSetup(Pipe):
    name = "gamepad"

    def move(self):
        event = struct.pack("=IhBB", 1, -32767, 2, 4)  # the right stick, pushed away
        os.write(self.writer, event[:3])
        self.wait(0.01)
        self.device.read()  # half a record
        self.send(event[3:])

    def press(self):
        self.send(struct.pack("=IhBB", 1, 1, 1, 0))


class MouseSetup(Pipe):
    name = "mouse"

    def move(self):
        self.send(bytes([0x08, 0, 100]))
        self.device.read()
        self.send(bytes([0x28, 0, 256 - 20]))  # and back a little

    def press(self):
        self.send(bytes([0x09, 0, 0]))


class KeyboardSetup(OperatorSetup):
    name = "keyboard"

    def settings(self):
        self.master, self.slave = pty.openpty()
        return {"terminal": os.ttyname(self.slave)}

    def type(self, keys):
        os.write(self.master, keys)
        select.select([self.device._file], [], [], 60.0)  # until they are through the kernel
        self.wait(0.02)

    def move(self):
        self.type(b"rR?rrr")

    def press(self):
        self.type(b" ")

    def unplug(self):
        os.close(self.master)
        self.master = None

    def close(self):
        super().close()
        os.close(self.slave)
        if self.master is not None:
            os.close(self.master)


@cache
def _compiled_stand_in():
    folder = Path(tempfile.mkdtemp(prefix="palpate-touch-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    source = Path(__file__).parent / "openhaptics_stand_in.c"
    command = ["gcc", "-shared", "-fPIC", "-O1", "-pthread", "-o", folder / "libHD.so", source]
    subprocess.run(command, check=True)
    return folder / "libHD.so"


class TouchSetup(OperatorSetup):
    name = "touch"
    clock_type = MonotonicClock
    oldest_s = 60.0

    def settings(self):
        if shutil.which("gcc") is None:
            pytest.skip("no gcc to compile the stand-in for OpenHaptics")
        library = self.folder / "libHD.so"  # each test a copy of its own: the stand-in keeps a state
        if not library.exists():
            shutil.copy(_compiled_stand_in(), library)
        self.library = ctypes.CDLL(str(library))
        return {"library": str(library), "watchdog_s": 60.0, "oldest_s": 60.0}  # for machines under load

    def wait(self, duration_s):
        """Until the servo thread has been round a few times, however long that takes."""
        begun = self.library.stand_in_ticks()
        while self.library.stand_in_ticks() < begun + 3:
            time.sleep(1e-3)

    def move(self):
        self.library.stand_in_move(
            (ctypes.c_double * 3)(10.0, 20.0, 30.0), (ctypes.c_double * 3)(0.0, 50.0, 0.0)
        )
        self.wait(0.02)

    def press(self):
        self.library.stand_in_press(1)
        self.wait(0.02)

    def unplug(self):
        self.library.stand_in_unplug()
        self.wait(0.02)

    def force(self):
        values = (ctypes.c_double * 3)()
        self.library.stand_in_force(values)
        return np.array(values)

    def close(self):
        super().close()
        self.library.stand_in_press(0)


class LeaderArmSetup(OperatorSetup):
    name = "leader_arm"

    def settings(self):
        path = write_mock_files(self.folder)
        return {"robot": str(path), "drivers": ["tests.mock_robot"], "select_force_n": 2.0}

    @property
    def bus(self):
        return mock_bus(self.device._robot)

    def push_up(self, force_n, duration_s):
        self.bus.plant.hand_force_n = force_n
        for _ in range(round(duration_s / 0.002)):
            self.wait(0.002)
            self.device.read()

    def move(self):
        self.push_up(0.5, 0.2)

    def press(self):
        self.push_up(3.0, 0.01)

    def unplug(self):
        self.bus.faults.unplugged = True


OPERATOR_SETUPS = (Scripted, KeyboardSetup, MouseSetup, GamepadSetup, TouchSetup, LeaderArmSetup)
