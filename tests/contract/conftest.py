"""One robot per backend for every contract test."""

import pytest

from tests.contract.backends import BACKENDS
from tests.wire.conftest import few_ids

__all__ = ["few_ids"]

CONTRACT_OF = {
    "test_torque_contract": "drives",
    "test_encoder_contract": "drives",
    "test_force_contract": "force",
}


def pytest_generate_tests(metafunc):
    if "backend" in metafunc.fixturenames:
        of = CONTRACT_OF.get(metafunc.module.__name__.rpartition(".")[2], "whole")
        chosen = [backend for backend in BACKENDS if backend.known != of]
        metafunc.parametrize("backend", chosen, ids=lambda backend: backend.name, indirect=True)


@pytest.fixture
def backend(request):
    return request.param


@pytest.fixture
def open_setup(backend):
    """Make new robots, and close them all at the end."""
    opened = []

    def make():
        opened.append(backend.open())
        return opened[-1]

    yield make
    for robot_setup in opened:
        robot_setup.close()


@pytest.fixture
def robot_setup(open_setup):
    """A fresh robot in state NEW."""
    return open_setup()


@pytest.fixture
def active(robot_setup):
    """An active robot whose devices have all sampled."""
    robot_setup.robot.configure()
    robot_setup.robot.activate()
    robot_setup.settle()
    return robot_setup
