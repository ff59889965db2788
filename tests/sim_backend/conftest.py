"""Tests of physics run in each engine; those of sensors, forces at the tip, files and drivers in one."""

import pytest

from sim_backend import engines

PHYSICS = {"test_world", "test_arm_physics", "test_contact_physics", "test_imperfections_joint"}


def pytest_generate_tests(metafunc):
    module = metafunc.module.__name__.rpartition(".")[2]
    chosen = any("engine" in mark.args for mark in metafunc.definition.iter_markers("parametrize"))
    if module in PHYSICS and not chosen:
        metafunc.parametrize("engine", sorted(engines._ENGINES), indirect=True)


@pytest.fixture(autouse=True)
def engine(request, monkeypatch):
    """Name of the engine that scenarios choose by default."""
    name = getattr(request, "param", engines.default_engine())
    pytest.importorskip(engines._ENGINES[name][0])
    monkeypatch.setattr(engines, "_ENGINES", {name: engines._ENGINES[name]} | engines._ENGINES)
    return name
