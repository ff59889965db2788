"""Whether the ports that a robot file names are there and may be opened; only looked at, not opened."""

import os
from collections.abc import Iterator
from pathlib import Path

from palpate.doctor.finding import Finding, fail, ok, warn
from palpate.doctor.hardware import USB_LATENCY_MS, can_interface_state, latency_timer_ms
from robot_io.robot_file import RobotFile

_DIALOUT = "sudo usermod -aG dialout $USER, log in again"


def examine_ports(robot_file: RobotFile) -> Iterator[tuple[str, Finding]]:
    """Serial ports (setting `port`) and SocketCAN interfaces (setting `channel`), with the bus of each."""
    for name, bus in robot_file.buses.items():
        port, channel = bus.settings.get("port"), bus.settings.get("channel")
        if isinstance(port, str) and port.startswith("/"):
            yield name, _serial_port(f"port of {name}", Path(port))
        elif bus.settings.get("interface") == "socketcan" and isinstance(channel, str):
            yield name, _can_interface(f"port of {name}", channel)


def _serial_port(subject: str, port: Path) -> Finding:
    if not port.exists():
        there = sorted(Path("/dev/serial/by-id").glob("*"))
        others = ", ".join(map(str, there)) or "no USB adapter is connected"
        return fail(subject, f"{port}: is not there", f"plug it in, or correct the robot file ({others})")
    if not port.is_char_device():
        return fail(subject, f"{port}: is no serial port", "correct the robot file")
    if not os.access(port, os.R_OK | os.W_OK):
        return fail(subject, f"{port}: no right to open it", _DIALOUT)
    latency_ms = latency_timer_ms(port.resolve())
    if latency_ms is not None and latency_ms > USB_LATENCY_MS:
        setting = f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{port.resolve().name}/latency_timer"
        return warn(subject, f"{port}: the adapter waits {latency_ms} ms before it delivers", setting)
    return ok(subject, f"{port}: there, and may be opened")


def _can_interface(subject: str, channel: str) -> Finding:
    up = f"sudo ip link set {channel} up type can bitrate 1000000"
    state = can_interface_state(channel)
    if state is None:
        return fail(subject, f"{channel}: no such CAN interface", f"plug the adapter in; then: {up}")
    if state != "up":
        return fail(subject, f"{channel}: is {state}", up)
    return ok(subject, f"{channel}: is up")
