"""Any operator device of palpate as a LeRobot teleoperator: haptic device, leader arm, gamepad, script.

The operator's hand moves the tip of a virtual arm whose tool keeps one direction; the joints of that arm are
the action, in degrees.
"""

import sys
import threading
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.teleop.leader_arm import build_operator
from palpate.control.teleop.virtual_object import VirtualArm
from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.errors import InputError, PalpateError
from palpate.runs.robots import find_robot

_PERIOD_S = 2e-3  # of reading and pushing the hand
_ROBOTS = "lerobot_robot_palpate"  # module that knows the force at the tips of this program's arms


@TeleoperatorConfig.register_subclass("palpate")
@dataclass(kw_only=True)
class PalpateTeleoperatorConfig(TeleoperatorConfig):
    """Who moves which arm."""

    operator: str  # name of an operator device, or a YAML file that names one with its settings
    robot_file: str = "follower"  # robot file of the arm whose joints are sent, or a shipped arm
    tool_world: list[float] = field(default_factory=lambda: [0.0, 0.0, -1.0])  # direction that the tool keeps
    force_share: float = 0.0  # how much of the force at the tip pushes the hand, 0 to 1


class PalpateTeleoperator(Teleoperator):
    """The joints of a virtual arm of three joints in a plane, whose tip follows the operator's hand."""

    config_class = PalpateTeleoperatorConfig
    name = "palpate"

    def __init__(self, config: PalpateTeleoperatorConfig) -> None:
        super().__init__(config)
        if not 0.0 <= config.force_share <= 1.0:
            raise InputError(f"force_share {config.force_share}: must be between 0 and 1")
        robot_file = find_robot(config.robot_file)
        body = RigidBody.of_robot(robot_file)
        self.joints = body.joint_names
        self._tool = np.array(config.tool_world)
        home_rad = np.array(robot_file.home_rad)
        self._arm = VirtualArm(body, np.array(robot_file.sensor_axis_tip), self._tool, home_rad)
        self._share = config.force_share
        self._feedback_n: float | None = None  # as a program sends it; LeRobot's own loops send none
        self._clock = MonotonicClock()
        self._device = build_operator(config.operator, self._clock)
        self._hand: threading.Thread | None = None
        self._over = threading.Event()
        self._error: Exception | None = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.joints}

    @property
    def feedback_features(self) -> dict[str, type]:
        return {"force": float}

    @property
    def is_connected(self) -> bool:
        return self._hand is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        """Nothing to do: operator devices need none."""

    def configure(self) -> None:
        """Nothing to do: the operator's file says everything."""

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        self._device.configure()
        self._device.activate()
        self._arm.follow(self._device.read().position_world_m)
        self._over.clear()
        self._error = None
        self._hand = threading.Thread(target=self._follow_hand, daemon=True)
        self._hand.start()

    @check_if_not_connected
    def get_action(self) -> dict[str, float]:
        if self._error is not None:
            raise PalpateError(f"the operator's device has failed: {self._error}") from self._error
        return dict(zip(self.action_features, np.degrees(self._arm.position_rad).tolist(), strict=True))

    @check_if_not_connected
    def send_feedback(self, feedback: dict[str, float]) -> None:
        self._feedback_n = float(feedback["force"])

    def disconnect(self) -> None:
        self._over.set()
        if self._hand is not None:
            self._hand.join()
            self._hand = None
        self._device.close()

    def _follow_hand(self) -> None:
        try:
            while not self._over.wait(_PERIOD_S):
                self._arm.follow(self._device.read().position_world_m)
                if self._share:
                    force_n, robots = self._feedback_n, sys.modules.get(_ROBOTS)
                    if force_n is None:
                        force_n = robots.felt_force_n() if robots is not None else 0.0
                    self._device.set_force(-self._share * force_n * self._tool)
        except Exception as error:  # get_action tells
            self._error = error
