"""The shipped arms in their simulated world, for tests of whole probing runs."""

from pathlib import Path

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import LoopResult
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import load_robot_file
from tests.control.loop_parts import MemoryLog

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
NAMES = ["follower", "leader"]


def kelvin_voigt(stiffness_n_m: float, damping_n_s_m: float = 20.0, surface_m: float = 0.12) -> dict:
    """The section `object` of a scenario; 60 mm below the tips at home, so that they are soon there."""
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness_n_m, "damping_n_s_m": damping_n_s_m}
    return {"object": {"law": law, "surface_height_m": surface_m}}


class SimulatedArm:
    """An arm above an object, ready for `run`; what truly happens is kept whenever time passes.

    Args:
        name: of the arm.
        plan: what to do.
        scenario: what the world is, as in a scenario file.
        gravity: whether the guard knows the arm's weight.
        stop: changed values of the robot file's section `safe_state`.
    """

    def __init__(
        self, name: str, plan: ProbingPlan, scenario: dict, gravity: bool = True, **stop: float
    ) -> None:
        robot_file = load_robot_file(ARMS / name / f"{name}.yaml")
        self.robot_file = robot_file
        self.clock, self.log = SimulatedClock(), MemoryLog()
        self.robot = build_robot(robot_file, DriverCatalog("palpate.sim_backend.drivers"), self.clock)
        self.task = ProbingTask.from_robot_file(robot_file, plan)
        body = RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame)
        weight = body.gravity if gravity else None
        safe_state = robot_file.safe_state.model_copy(update=stop)
        self.guard = Guard(robot_file.limits, safe_state, robot_file.joint_count, weight)
        bus = self.robot.buses["world"]
        bus.use_scenario(bus.scenario.model_validate(scenario))
        self.robot.configure()
        self.world = bus.world
        self.rows: list[tuple[float, float, float, float]] = []
        self.clock.subscribe(self._keep)

    def _keep(self, _time_s: float) -> None:
        """Record the true state without the arrays of `World.truth`."""
        world, contact = self.world, self.world._contact
        speed_rad_s = max(map(abs, world._joint_values()[world.joint_count :]))
        self.rows.append((world.time_s, contact.tip_position_m[2], contact.force_n, speed_rad_s))

    def run(self, stop=lambda: "") -> LoopResult:
        """Probe until it is done or stopped."""
        return run_loop(self.robot, self.guard, self.task, self.clock, self.log, rate_hz=1000.0, stop=stop)

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        for _ in range(round(1e3 * duration_s)):
            self.clock.sleep_until(self.clock.now_s() + 1e-3)

    @property
    def truth(self) -> np.ndarray:
        """Columns: time [s], tip height [m], force [N], fastest joint [rad/s]."""
        return np.array(self.rows)
