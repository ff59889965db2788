"""One bench per backend for every contract test."""

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
    reason = request.param.missing()
    if reason:
        pytest.skip(reason)
    return request.param


@pytest.fixture
def open_bench(backend):
    """Makes fresh benches, and closes them all at the end."""
    opened = []

    def make():
        opened.append(backend.open())
        return opened[-1]

    yield make
    for bench in opened:
        bench.close()


@pytest.fixture
def bench(open_bench):
    """A fresh robot in state NEW."""
    return open_bench()


@pytest.fixture
def active(bench):
    """An active robot whose devices have all sampled."""
    bench.robot.configure()
    bench.robot.activate()
    bench.settle()
    return bench
