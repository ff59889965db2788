"""Any arm with a palpate robot file as a LeRobot robot, with its guard and its force sensor.

Units are LeRobot's: degrees, degrees per second and N m; the force is in N, positive in compression.
"""

import shlex
import sys
import weakref
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path

import numpy as np
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.runs.following import FollowingArm, FollowingJob
from palpate.runs.robots import find_robot, importable
from palpate.sim_backend.scenario import load_scenario

_CONNECTED: "weakref.WeakSet[PalpateRobot]" = weakref.WeakSet()


def felt_force_n() -> float:
    """The newest force at the tips of all connected arms together, positive in compression [N]."""
    return sum(robot.force_n for robot in _CONNECTED)


@RobotConfig.register_subclass("palpate")
@dataclass(kw_only=True)
class PalpateRobotConfig(RobotConfig):
    """Which arm, and how it moves."""

    robot_file: str = "follower"  # robot file, or a shipped arm
    session: Path | None = None  # palpate session of every tick; default: a new one in sessions/
    speed_share: float = 0.5  # fastest approach of a goal, as a share of the guard's speed limits
    acceleration_deg_s2: float = 600.0  # largest acceleration towards a goal
    record_time: bool = False  # observe when the encoders sampled, too: LeRobot's own times are idealised
    wire: bool = False  # emulate the devices, byte by byte; no hardware is touched
    scenario: str | None = None  # of a simulated or emulated arm: a file or a shipped one
    hidden: str | None = None  # effects to hide in a simulated arm, see `palpate probe --hidden`
    seed: int | None = None  # of all simulated noise
    drivers: list[str] = field(default_factory=list)  # Python packages with drivers of your own
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class PalpateRobot(Robot):
    """An arm that follows joint goals; see `palpate.runs.following`.

    A stop of the guard raises `palpate.robot_io.errors.SafetyTripError` from the next observation or action,
    when the arm is at rest without torque.
    """

    config_class = PalpateRobotConfig
    name = "palpate"

    def __init__(self, config: PalpateRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self._file = find_robot(config.robot_file)
        axes = RigidBody.of_robot(self._file).joint_axes()
        self.joints = tuple(axis.name for axis in axes)
        if sliding := [axis.name for axis in axes if not axis.revolute]:
            raise InputError(f"{self._file.path}: joint '{sliding[0]}' slides, and LeRobot counts in degrees")
        self.cameras = make_cameras_from_configs(config.cameras)
        self._arm: FollowingArm | None = None
        self._begun_s = 0.0  # of the arm's clock
        self.force_n = 0.0

    @cached_property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        quantities = ("pos", "vel", "torque")
        features: dict[str, type | tuple[int, int, int]] = {
            f"{joint}.{quantity}": float for quantity in quantities for joint in self.joints
        }
        images = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        times = {"time": float} if self.config.record_time else {}
        return {**features, "force": float, **times, **images}

    @cached_property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.joints}

    @property
    def is_connected(self) -> bool:
        return self._arm is not None and self._arm.running

    @property
    def is_calibrated(self) -> bool:
        return True  # by the calibration files that the robot file names

    def calibrate(self) -> None:
        """Nothing to do: `palpate calibrate` does it, and the robot file names the result."""

    def configure(self) -> None:
        """Nothing to do: palpate configures the devices as the robot file says."""

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        config = self.config
        stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
        path = config.session or Path("sessions") / f"{stamp}-{self._file.name}-lerobot.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        job = FollowingJob(
            self._file,
            path,
            scenario=load_scenario(config.scenario) if config.scenario is not None else None,
            seed=config.seed,
            hidden=config.hidden,
            wired=config.wire,
            paced=True,
            drivers=importable(config.drivers),
            command_line=shlex.join(sys.argv),
            speed_share=config.speed_share,
            acceleration_rad_s2=float(np.radians(config.acceleration_deg_s2)),
        )
        for camera in self.cameras.values():
            camera.connect()
        self._arm = FollowingArm(job)
        self._begun_s = self._arm.start().encoder_at_s
        _CONNECTED.add(self)

    @check_if_not_connected
    def get_observation(self) -> dict[str, object]:
        measurement = self._arm.measure()
        self.force_n = measurement.force_n
        values = np.concatenate(
            (
                np.degrees(measurement.joint_position_rad),
                np.degrees(measurement.joint_velocity_rad_s),
                measurement.joint_torque_nm,
                (measurement.force_n, measurement.encoder_at_s - self._begun_s),
            )
        )
        names = [name for name, kind in self.observation_features.items() if kind is float]
        images = {name: camera.read_latest() for name, camera in self.cameras.items()}
        return {**dict(zip(names, values.tolist(), strict=False)), **images}  # the time is the last value

    @check_if_not_connected
    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        arm = self._arm
        goal_rad = np.radians([action[name] for name in self.action_features])
        self.force_n = arm.follow(goal_rad).force_n
        sent_rad = goal_rad.clip(arm.low_rad, arm.high_rad)
        return dict(zip(self.action_features, np.degrees(sent_rad).tolist(), strict=True))

    def disconnect(self) -> None:
        _CONNECTED.discard(self)
        try:
            if self._arm is not None:
                self._arm.stop()
        finally:
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()
