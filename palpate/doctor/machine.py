"""Check this machine: interpreter, packages, simulation, and the requirements of a real arm.

Simulation does not need the requirements of a real arm, so a missing one is never a failure.
"""

import os
import resource
import sys
from collections.abc import Callable, Iterator
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from platform import python_version

import numpy as np
from packaging.requirements import Requirement

from palpate.common import preflight
from palpate.common.console import has_display
from palpate.robot_io.examination import Finding, Level, fail, graded, ok, warn
from palpate.robot_io.extras import missing_package

CONSTRAINTS = Path(__file__).resolve().parents[2] / "constraints.txt"
GRAVITY = 9.81  # [m/s2]
_MASS_ON_A_RAIL = """
<robot name="drop"><link name="rail"/>
  <link name="mass"><inertial><mass value="1"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="fall" type="prismatic"><parent link="rail"/><child link="mass"/><axis xyz="0 0 1"/>
    <limit lower="-10" upper="10" effort="10" velocity="10"/></joint></robot>"""
ARPHRD_CAN = "280"  # kernel's hardware type of a CAN interface, include/uapi/linux/if_arp.h
USB_LATENCY_MS = 1
VULKAN_DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
_WARN, _FAIL = Level.WARN, Level.FAIL
DIALOUT = "sudo usermod -aG dialout $USER, log in again"
RIGHTS = (
    "add '@realtime - rtprio 95' and '@realtime - memlock unlimited' to /etc/security/limits.conf, "
    "join the group 'realtime', log in again"
)


def python() -> Iterator[Finding]:
    """Check for a supported CPython in a virtual environment."""
    problem = preflight.python_problem((sys.version_info[0], sys.version_info[1])) or ""
    bare = "not a virtual environment: run make env, then use .venv/bin/palpate"
    value = f"{python_version()} in {sys.prefix}"
    yield graded("python", value, (_FAIL, problem, problem), (_WARN, sys.prefix == sys.base_prefix, bare))


def packages() -> Iterator[Finding]:
    """Check that every dependency is installed in its tested version."""
    # pinned versions by package; empty if palpate is installed without its source tree
    text = CONSTRAINTS.read_text(encoding="utf-8") if CONSTRAINTS.is_file() else ""
    pairs = (line.split("==") for line in text.splitlines() if "==" in line)
    pinned = {name.strip().lower(): version.strip() for name, version in pairs}
    required = [Requirement(line) for line in metadata.requires("palpate") or []]
    needed = [each for each in required if not each.marker or each.marker.evaluate({"extra": ""})]
    names = [each.name.lower() for each in needed]
    missing, untested = [], []
    for name in names:
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            missing.append(name)
            continue
        if pinned.get(name, version) != version:
            untested.append(f"{name} {version} (tested: {pinned[name]})")
    if missing:
        yield fail("packages", f"not installed: {', '.join(missing)}", "make clean env")
    if untested:
        yield warn("packages", f"untested versions: {', '.join(untested)}", "make clean env")
    if not missing and not untested:
        yield ok("packages", f"all {len(names)} installed" + (", in the tested versions" if pinned else ""))


def physics_engines() -> Iterator[Finding]:
    """Check that every installed physics engine lets a dropped mass fall correctly."""
    from palpate.sim_backend.engines import engine_class, installed_engines  # noqa: PLC0415, a failing import is a finding

    engines = installed_engines()
    if not engines:
        yield ok("physics engine", f"none (only a simulation needs one); {missing_package('mujoco')}")
    for name in engines:
        step_s = 1e-3
        engine = engine_class(name)(_MASS_ON_A_RAIL, "mass", step_s=step_s, gravity_m_s2=(0.0, 0.0, -GRAVITY))
        try:
            engine.step()
            speed, expected = engine.joint_state()[1], -GRAVITY * step_s
        finally:
            engine.close()
        value = f"a dropped mass falls at {speed:.6f} m/s, expected {expected:.6f}"
        yield graded(name, value, (_FAIL, abs(speed - expected) > 1e-6, "make clean env"))


def pinocchio() -> Iterator[Finding]:
    """Check that a rigid-body model can be built and evaluated."""
    if not find_spec("pinocchio"):
        yield ok("pinocchio", f"only an arm needs it; {missing_package('pinocchio')}")
        return
    import pinocchio as pin  # noqa: PLC0415

    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    torque = pin.rnea(model, model.createData(), np.zeros(1), np.zeros(1), np.zeros(1))
    value = f"{metadata.version('pin')}, {os.cpu_count()} processors"
    yield graded("pinocchio", value, (_FAIL, torque.shape != (1,), "make clean env"))


def rerun() -> Iterator[Finding]:
    """Check that the viewer is installed, and that it has a display or a Vulkan driver."""
    if not find_spec("rerun"):
        yield ok("rerun", f"only recordings need it; {missing_package('rerun')}")
        return
    shows = (
        "with a display" if has_display() else "no display: recordings and screenshots are written to files"
    )
    blind = not has_display() and not has_vulkan_driver()
    if blind:
        shows = "neither display nor Vulkan driver: recordings work, screenshots do not"
    value = f"{metadata.version('rerun-sdk')}, {shows}"
    yield graded("rerun", value, (Level.WARN, blind, "apt install mesa-vulkan-drivers"))


def has_vulkan_driver() -> bool:
    """Return whether a Vulkan driver is installed; a software renderer suffices."""
    return any(Path(folder).is_dir() and any(Path(folder).glob("*.json")) for folder in VULKAN_DRIVERS)


def real_time() -> Iterator[Finding]:
    """Check that the control loop may run under SCHED_FIFO, on a real-time kernel."""
    is_made = _text(Path("/sys/kernel/realtime")) == "1" or "PREEMPT_RT" in os.uname().version
    kernel = "real-time kernel" if is_made else "ordinary kernel (expect rare late ticks)"
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:  # set it for a moment
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        yield warn("real time", f"SCHED_FIFO not permitted, {kernel}: ticks come late under load", RIGHTS)
    else:
        os.sched_setscheduler(0, policy, parameters)
        yield ok("real time", f"SCHED_FIFO permitted, {kernel}")


def memory_lock() -> Iterator[Finding]:
    """Check that the loop's memory can be locked against swapping."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    limited = os.geteuid() != 0 and soft != resource.RLIM_INFINITY
    value = f"limited to {soft // 2**20} MiB" if limited else "unlimited"
    yield graded("memory lock", value, (_WARN, limited, RIGHTS))


def serial_ports() -> Iterator[Finding]:
    """Check USB serial adapters: permission and latency timer."""
    ports = sorted(Path("/dev").glob("ttyUSB*")) + sorted(Path("/dev").glob("ttyACM*"))
    if not ports:
        yield ok("serial ports", "none connected (only a real arm needs one)")
    yield from (serial_port("serial ports", port, Level.WARN) for port in ports)


def serial_port(subject: str, port: Path, denied: Level) -> Finding:
    """Check the permission (level `denied` if missing) and latency timer of a serial port.

    Args:
        subject: subject of the finding.
        port: device file.
        denied: level of the finding if the port may not be opened.
    """
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding(subject, f"{port}: permission denied", DIALOUT, denied)
    name = port.resolve().name
    latency_ms = _text(Path("/sys/bus/usb-serial/devices") / name / "latency_timer")
    if latency_ms.isdigit() and int(latency_ms) > USB_LATENCY_MS:
        setting = f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{name}/latency_timer"
        return warn(subject, f"{port}: the adapter waits {latency_ms} ms before it delivers data", setting)
    return ok(subject, f"{port}: may be opened")


def can_interfaces() -> Iterator[Finding]:
    """Check whether SocketCAN interfaces are up."""
    types = sorted(Path("/sys/class/net").glob("*/type"))
    names = [entry.parent.name for entry in types if _text(entry) == ARPHRD_CAN]
    if not names:
        yield ok("CAN", "no interface (only a real arm on CAN needs one)")
    yield from (can_interface("CAN", name, Level.WARN) for name in names)


def can_interface(subject: str, name: str, down: Level) -> Finding:
    """Check that a CAN interface exists and is up.

    Args:
        subject: title of the finding.
        name: name of the interface, such as "can0".
        down: level of the finding if the interface is not up; a missing one always fails.
    """
    interface = Path("/sys/class/net") / name
    bring_up = f"sudo ip link set {name} up type can bitrate 1000000"
    if _text(interface / "type") != ARPHRD_CAN:
        return fail(subject, f"{name}: no such CAN interface", f"plug the adapter in; then: {bring_up}")
    state = _text(interface / "operstate")
    return graded(subject, f"{name} is {state}", (down, state != "up", bring_up))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    *(python, packages, physics_engines, pinocchio, rerun),
    *(real_time, memory_lock, serial_ports, can_interfaces),
)


def examine_all() -> Iterator[Finding]:
    """Run every check; a check that raises becomes a finding, and the others still run."""
    for check in CHECKS:
        try:
            yield from check()
        except Exception as error:
            subject = check.__name__.replace("_", " ")
            remedy = preflight.library_remedy(error) if isinstance(error, ImportError) else None
            yield fail(subject, f"{type(error).__name__}: {error}", remedy or "run: make clean env")
