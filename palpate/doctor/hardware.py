"""What a real arm needs from the machine. Simulation needs none of it, so nothing here is a failure."""

import os
import resource
from collections.abc import Iterator
from pathlib import Path

from palpate.doctor.finding import Finding, ok, warn

ARPHRD_CAN = "280"  # kernel's hardware type of a CAN interface, include/uapi/linux/if_arp.h
USB_LATENCY_MS = 1
RIGHTS = (
    "add '@realtime - rtprio 95' and '@realtime - memlock unlimited' to /etc/security/limits.conf, "
    "join the group 'realtime', log in again"
)


def real_time() -> Iterator[Finding]:
    """The loop may run under SCHED_FIFO, on a kernel that is made for it."""
    kernel = "real-time kernel" if _is_real_time_kernel() else "ordinary kernel (expect rare late ticks)"
    if _may_use_fifo():
        yield ok("real time", f"SCHED_FIFO permitted, {kernel}")
    else:
        yield warn("real time", f"SCHED_FIFO not permitted, {kernel}: ticks come late under load", RIGHTS)


def memory_lock() -> Iterator[Finding]:
    """The loop's memory can be kept from being swapped out."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() == 0 or soft == resource.RLIM_INFINITY:
        yield ok("memory lock", "unlimited")
    else:
        yield warn("memory lock", f"limited to {soft // 2**20} MiB", RIGHTS)


def serial_ports() -> Iterator[Finding]:
    """USB serial adapters, the right to open them, and their buffering time."""
    ports = sorted(Path("/dev").glob("ttyUSB*")) + sorted(Path("/dev").glob("ttyACM*"))
    if not ports:
        yield ok("serial ports", "none connected (only a real arm needs one)")
    for port in ports:
        if not os.access(port, os.R_OK | os.W_OK):
            yield warn(
                "serial ports", f"{port}: no right to open it", "sudo usermod -aG dialout $USER, log in again"
            )
        elif (latency_ms := latency_timer_ms(port)) is not None and latency_ms > USB_LATENCY_MS:
            setting = f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{port.name}/latency_timer"
            yield warn(
                "serial ports", f"{port}: the adapter waits {latency_ms} ms before it delivers", setting
            )
        else:
            yield ok("serial ports", str(port))


def can_interfaces() -> Iterator[Finding]:
    """SocketCAN interfaces and whether they are up."""
    interfaces = [
        entry.parent for entry in Path("/sys/class/net").glob("*/type") if _text(entry) == ARPHRD_CAN
    ]
    if not interfaces:
        yield ok("CAN", "no interface (only a real arm on CAN needs one)")
    for interface in sorted(interfaces):
        if _text(interface / "operstate") == "up":
            yield ok("CAN", f"{interface.name} is up")
        else:
            setting = f"sudo ip link set {interface.name} up type can bitrate 1000000"
            yield warn("CAN", f"{interface.name} is down", setting)


def _is_real_time_kernel() -> bool:
    return _text(Path("/sys/kernel/realtime")) == "1" or "PREEMPT_RT" in os.uname().version


def _may_use_fifo() -> bool:
    """Try it for a moment, and go back."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameters)
    return True


def can_interface_state(name: str) -> str | None:
    """Such as "up" or "down"; None where there is no such CAN interface."""
    interface = Path("/sys/class/net") / name
    return _text(interface / "operstate") if _text(interface / "type") == ARPHRD_CAN else None


def latency_timer_ms(port: Path) -> int | None:
    """How long a USB serial adapter collects bytes before it hands them on [ms]; None for other ports."""
    text = _text(Path("/sys/bus/usb-serial/devices") / port.name / "latency_timer")
    return int(text) if text.isdigit() else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
