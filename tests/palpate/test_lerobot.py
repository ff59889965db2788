"""LeRobot plugins, on the real package where installed, else on the used parts of it."""

import importlib.metadata as metadata
import importlib.util
import inspect
import sys
import time
import tomllib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import wraps
from types import ModuleType

import numpy as np
import pytest

from palpate.robot_io.errors import InputError, PalpateError, SafetyTripError
from palpate.runs.robots import shipped_robots
from tests.palpate.cli import ROOT

PLUGINS = ("lerobot_robot_palpate", "lerobot_teleoperator_palpate")
IS_REAL = importlib.util.find_spec("lerobot") is not None
needs_lerobot = pytest.mark.skipif(not IS_REAL, reason="LeRobot is not installed")
COMMON = {
    *("action_features", "is_connected", "connect", "is_calibrated", "calibrate"),
    "configure",
    "disconnect",
}
ABSTRACT = {  # of LeRobot's base classes, 0.6
    "Robot": COMMON | {"observation_features", "get_observation", "send_action"},
    "Teleoperator": COMMON | {"feedback_features", "get_action", "send_feedback"},
}


def stub_modules():
    """What the plugins import of LeRobot, with its own checks and nothing else."""

    class Config:
        choices: dict

        @classmethod
        def register_subclass(cls, name):
            def add(subclass):
                cls.choices[name] = subclass
                return subclass

            return add

    def device(name, config):
        def init(self, config):
            self.id = config.id

        methods = {method: abstractmethod(lambda self: None) for method in ABSTRACT[name]}
        made = type(name, (ABC,), {"__init__": init, **methods})
        fields = {"id": None, "calibration_dir": None}
        kinds = {"__annotations__": dict.fromkeys(fields, object)}
        config = dataclass(kw_only=True)(type(config, (Config,), {"choices": {}, **kinds, **fields}))
        return {name: made, config.__name__: config}

    def check(connected, error):
        def decorate(method):
            @wraps(method)
            def checked(self, *arguments):
                if self.is_connected is not connected:
                    raise error
                return method(self, *arguments)

            return checked

        return decorate

    contents = {
        "lerobot": {},
        "lerobot.utils": {},
        "lerobot.utils.decorators": {
            "check_if_not_connected": check(True, ConnectionError("not connected")),
            "check_if_already_connected": check(False, ConnectionError("already connected")),
        },
        "lerobot.cameras": {"CameraConfig": object, "make_cameras_from_configs": dict},
        "lerobot.robots": device("Robot", "RobotConfig"),
        "lerobot.teleoperators": device("Teleoperator", "TeleoperatorConfig"),
    }
    modules = {name: ModuleType(name) for name in contents}
    for name, content in contents.items():
        vars(modules[name]).update(content)
    return modules


@pytest.fixture(scope="module")
def plugins():
    """Both plugins' modules."""
    with pytest.MonkeyPatch.context() as patch:
        if not IS_REAL:
            for name, module in stub_modules().items():
                patch.setitem(sys.modules, name, module)
        for name in PLUGINS:
            patch.delitem(sys.modules, name, raising=False)
            patch.syspath_prepend(ROOT / "integrations" / name)
        yield tuple(importlib.import_module(name) for name in PLUGINS)
        for name in PLUGINS:
            sys.modules.pop(name, None)


def robot_of(plugins, folder, **changed):
    config = plugins[0].PalpateRobotConfig(
        calibration_dir=folder / "calibration", session=folder / "arm.mcap", **changed
    )
    return plugins[0].PalpateRobot(config)


@pytest.fixture
def robot(plugins, tmp_path):
    robot = robot_of(plugins, tmp_path, seed=1, record_time=True)
    yield robot
    robot.disconnect()


def pressing(folder):
    """A script that goes from above an object 5 cm high into it."""
    path = folder / "operator.yaml"
    places = ((0.0, 0.18), (0.2, 0.18), (1.2, 0.04), (9.0, 0.04))
    points = "".join(f"  - {{time_s: {t}, position_world_m: [0.4, 0, {z}]}}\n" for t, z in places)
    path.write_text(f"device: scripted\npath:\n{points}")
    return path


def teleoperator(plugins, folder, **changed):
    config = plugins[1].PalpateTeleoperatorConfig(
        operator=str(pressing(folder)), calibration_dir=folder / "calibration", **changed
    )
    return plugins[1].PalpateTeleoperator(config)


def test_observation_is_complete_and_an_action_is_limited_to_the_guard(robot):
    home_deg = np.degrees(robot._file.home_rad)
    with pytest.raises(ConnectionError):
        robot.get_observation()
    robot.connect()
    with pytest.raises(ConnectionError):
        robot.connect()
    observation = robot.get_observation()
    assert set(observation) == set(robot.observation_features)
    assert [observation[f"{joint}.pos"] for joint in robot.joints] == pytest.approx(home_deg, abs=0.2)
    assert observation["shoulder.torque"] > 1.0  # N m, its weight
    assert abs(observation["force"]) < 0.2
    assert observation["time"] >= 0.0
    for _ in range(1000):  # the newest measurement may still be the one before
        if (later := robot.get_observation()["time"]) > observation["time"]:
            break
        time.sleep(0.01)
    assert later > observation["time"]
    sent = robot.send_action({"shoulder.pos": 45.0, "elbow.pos": -84.0, "wrist.pos": 1000.0})
    assert sent["shoulder.pos"] == pytest.approx(45.0)
    limit_deg = np.degrees(robot._file.limits.position_max_rad[2])
    assert limit_deg - 10.0 < sent["wrist.pos"] < limit_deg
    assert sent.keys() == robot.action_features.keys()


def record(robot, operator):
    """What LeRobot's loop does, without end."""
    while True:
        robot.get_observation()
        robot.send_action(operator.get_action())


@pytest.mark.slow
def test_guard_stop_ends_a_recording_with_its_cause(plugins, tmp_path):
    weak = tmp_path / "arm"
    weak.mkdir()
    for file in shipped_robots()["follower"].parent.iterdir():
        (weak / file.name).write_text(file.read_text().replace("force_n: 60.0", "force_n: 2.0"))
    robot = robot_of(plugins, tmp_path, robot_file=str(weak / "follower.yaml"))
    operator = teleoperator(plugins, tmp_path)
    operator.connect()
    robot.connect()
    try:
        with pytest.raises(SafetyTripError, match="force"):
            record(robot, operator)
    finally:
        assert robot.is_connected
        robot.disconnect()
        operator.disconnect()
    assert not robot.is_connected


@pytest.mark.slow
def test_operator_feels_the_arm_s_force_and_moves_its_joints(plugins, robot, tmp_path):
    deep, felt = teleoperator(plugins, tmp_path), teleoperator(plugins, tmp_path, force_share=1.0)
    robot.connect()
    for operator in (deep, felt):
        assert operator.action_features == robot.action_features
        with pytest.raises(ConnectionError):
            operator.get_action()
        operator.connect()
    first_deg = felt.get_action()["shoulder.pos"]
    force = 0.0
    while force < 2.0 and felt._hand.is_alive():
        force = robot.get_observation()["force"]
        robot.send_action(felt.get_action())
    for _ in range(400):
        robot.send_action(felt.get_action())
    height_m = [operator._device.read().position_world_m[2] for operator in (deep, felt)]
    assert height_m[1] > height_m[0] + 0.002  # the hand is pushed back
    assert abs(felt.get_action()["shoulder.pos"] - first_deg) > 1.0
    for operator in (deep, felt):
        operator.disconnect()
        assert not operator.is_connected


def test_failing_operator_device_ends_the_recording(plugins, tmp_path):
    operator = teleoperator(plugins, tmp_path, force_share=1.0)
    operator.connect()
    operator.send_feedback({"force": float("nan")})
    operator._hand.join(5.0)
    with pytest.raises(PalpateError, match="not finite"):
        operator.get_action()
    operator.disconnect()
    with pytest.raises(InputError, match="force_share 2"):
        teleoperator(plugins, tmp_path, force_share=2.0)


@pytest.mark.parametrize("name", PLUGINS)
def test_distribution_has_the_name_that_lerobot_expects(name):
    folder = ROOT / "integrations" / name
    project = tomllib.loads((folder / "pyproject.toml").read_text())
    assert project["project"]["name"] == name
    assert project["tool"]["setuptools"]["py-modules"] == [name]
    assert (folder / f"{name}.py").is_file()


@needs_lerobot
@pytest.mark.parametrize("kind", ["Robot", "Teleoperator"])
def test_lerobot_base_classes_match_the_plugins(plugins, kind):
    base = getattr(importlib.import_module(f"lerobot.{kind.lower()}s"), kind)
    plugin = getattr(plugins[kind == "Teleoperator"], f"Palpate{kind}")
    assert base.__abstractmethods__ == ABSTRACT[kind]
    assert not plugin.__abstractmethods__
    for name in ABSTRACT[kind]:
        asked, made = getattr(base, name), getattr(plugin, name)
        if callable(asked):
            assert list(inspect.signature(asked).parameters) == list(inspect.signature(made).parameters)


@needs_lerobot
def test_lerobot_finds_both_plugins_and_makes_them_by_type(plugins, tmp_path):
    try:
        for name in PLUGINS:
            metadata.distribution(name)
    except metadata.PackageNotFoundError as error:
        pytest.skip(f"{error} is not installed")
    robots, teleoperators = (
        importlib.import_module(f"lerobot.{kind}") for kind in ("robots", "teleoperators")
    )
    importlib.import_module("lerobot.utils.import_utils").register_third_party_plugins()
    kinds = robots.RobotConfig.get_known_choices(), teleoperators.TeleoperatorConfig.get_known_choices()
    assert all("palpate" in known for known in kinds)
    robot = robots.make_robot_from_config(kinds[0]["palpate"](calibration_dir=tmp_path))
    assert type(robot).__name__ == "PalpateRobot"
    operator = kinds[1]["palpate"](operator=str(pressing(tmp_path)), calibration_dir=tmp_path)
    made = teleoperators.make_teleoperator_from_config(operator)
    assert type(made).__name__ == "PalpateTeleoperator"
