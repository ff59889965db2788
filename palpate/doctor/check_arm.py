"""All that is looked at before an arm gets power, and then its signs, in the order in which it is shown."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from palpate.doctor.clearance import count_down
from palpate.doctor.devices import examine_devices
from palpate.doctor.finding import Finding, Level, fail, warn
from palpate.doctor.hand import EmulatedHand, Hand, Person
from palpate.doctor.limits import examine_limits
from palpate.doctor.nudge import examine_powered
from palpate.doctor.ports import examine_ports
from palpate.doctor.rates import examine_rates
from palpate.doctor.signs import examine_signs
from palpate.runs.robots import DEFAULT_SCENARIO, emulate, is_simulated
from palpate.runs.session import SIMULATED_DRIVERS
from robot_io.calibration import Calibrations, doubtful, load_calibrations
from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import InputError, PalpateError
from robot_io.raised import in_words
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import RobotFile
from sim_backend.emulators.faults import Faults
from sim_backend.scenario import load_scenario

_HELP = "see docs/hardware.md, 'First power-up'"
NOT_POWERED = warn(
    "drives", "not examined: the arm got no power", "palpate doctor --move, and a yes to its question"
)


@dataclass(frozen=True)
class ArmCheck:
    """What is to be examined, and how far.

    Attributes:
        robot_file: the arm.
        wired: emulate its devices.
        as_built: with `wired`, the arm as it is really put together; None: as its robot file says.
        faults: with `wired`, what goes wrong, by bus name.
        move: whether its signs are looked at too.
        may_power: asked before the arm gets power.
        drivers: packages with drivers beside palpate's own.
    """

    robot_file: RobotFile
    wired: bool = False
    as_built: RobotFile | None = None
    faults: dict[str, Faults] = field(default_factory=dict)
    move: bool = False
    may_power: Callable[[], bool] = lambda: False
    drivers: tuple[str, ...] = ()


def examine_arm(check: ArmCheck) -> Iterator[Finding]:
    """Limits, ports, devices, rates; then signs by hand; then a small motion. A failed stage is the last.

    The torque stays off until `may_power` has said yes, and it is off at the end.

    Raises:
        InputError: the robot file names what does not exist, has gains that no run takes, or cannot be
            emulated or moved by hand.
    """
    with ExitStack() as stack:
        drivers = DriverCatalogue(SIMULATED_DRIVERS, *check.drivers)
        drivers.check_names(check.robot_file)
        gains_of(check.robot_file)  # nothing here needs them, and every run does
        clock, robot_file, hand = _set_up(check, stack)
        calibrations = load_calibrations(check.robot_file, emulated=check.wired)
        body = RigidBody.of_robot(check.robot_file, calibrations)

        def make() -> Robot:
            return build_robot(robot_file, drivers, clock, calibrations)

        stages: list[Callable[[], Iterator[Finding]]] = [
            lambda: _unpowered(make(), robot_file, body, calibrations),
            lambda: _with_robot(make, lambda robot: examine_rates(robot, robot_file)),
        ]
        if check.move:
            stages += [
                lambda: _with_robot(make, lambda robot: examine_signs(robot, body, hand)),
                lambda: _powered(make, robot_file, body, hand, check.may_power),
            ]
        for stage in stages:
            failed = False
            for finding in stage():
                failed = failed or finding.level is Level.FAIL
                yield finding
            if failed:
                return


def _set_up(check: ArmCheck, stack: ExitStack) -> tuple[Clock, RobotFile, Hand]:
    """The clock, the robot file that leads to the devices, and who moves the arm."""
    if check.wired:
        clock = SimulatedClock()
        scenario = load_scenario(DEFAULT_SCENARIO)
        arm = emulate(check.robot_file, scenario, clock, as_built=check.as_built, faults=check.faults)
        stack.callback(arm.bench.close)
        return clock, arm.robot_file, EmulatedHand(arm.plant, arm.robot_file)
    if not is_simulated(check.robot_file):
        return MonotonicClock(), check.robot_file, Person()
    if check.move:
        raise InputError(
            f"--move: robot '{check.robot_file.name}' is simulated without devices: no hand can move it"
        )
    return SimulatedClock(), check.robot_file, Person()


def _unpowered(
    robot: Robot, robot_file: RobotFile, body: RigidBody, calibrations: Calibrations
) -> Iterator[Finding]:
    yield from examine_limits(robot_file, body)
    if calibrations.encoder and (doubt := doubtful(calibrations.encoder)):
        yield warn("zeros", doubt, "hold the arm in a known pose and compare; else palpate calibrate encoder")
    closed: set[str] = set()
    for bus, finding in examine_ports(robot_file):
        if finding.level is Level.FAIL:
            closed.add(bus)
        yield finding
    yield from examine_devices(robot, robot_file, closed)


def _with_robot(make: Callable[[], Robot], look: Callable[[Robot], Iterator[Finding]]) -> Iterator[Finding]:
    """Open the whole arm for one stage; it is closed, and so without torque, when the stage ends."""
    try:
        with make() as robot:
            yield from look(robot)
    except InputError:
        raise
    except PalpateError as error:
        yield fail("arm", str(error), _HELP)
    except Exception as error:  # a driver of somebody's own may fail with anything: that is a finding
        yield fail("arm", in_words(error), "correct the driver")


def _powered(
    make: Callable[[], Robot],
    robot_file: RobotFile,
    body: RigidBody,
    hand: Hand,
    may_power: Callable[[], bool],
) -> Iterator[Finding]:
    if not may_power():
        yield NOT_POWERED
        return

    def look(robot: Robot) -> Iterator[Finding]:
        objections = list(count_down(robot, hand))
        yield from objections
        if not objections:
            yield from examine_powered(robot, robot_file, body)

    yield from _with_robot(make, look)
