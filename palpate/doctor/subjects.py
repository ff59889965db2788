"""All checks in the order in which they are shown."""

from collections.abc import Callable, Iterator

from palpate.doctor import environment, hardware, simulation, viewer
from palpate.doctor.finding import Finding, fail
from palpate.preflight import library_remedy

CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    environment.python,
    environment.control_package,
    environment.packages,
    simulation.pybullet,
    simulation.pinocchio,
    viewer.rerun,
    viewer.viewer_port,
    hardware.real_time,
    hardware.memory_lock,
    hardware.serial_ports,
    hardware.can_interfaces,
)


def examine_all() -> Iterator[Finding]:
    """Run every check; one that breaks is itself a finding, never the end of the examination."""
    for check in CHECKS:
        try:
            yield from check()
        except Exception as error:
            subject = check.__name__.replace("_", " ")
            remedy = library_remedy(error) if isinstance(error, ImportError) else None
            yield fail(subject, f"{type(error).__name__}: {error}", remedy or "run: make clean env")
