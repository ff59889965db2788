"""Physics tests run in each engine; sensors, tip forces, files and drivers in one."""

import weakref

import pytest

from palpate.sim_backend import engines
from palpate.sim_backend.world import World

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


@pytest.fixture(autouse=True)
def worlds(monkeypatch):
    """Those that a test has made are closed at its end."""
    made, begin = [], World.__init__

    def begun(self, *args, **options):
        begin(self, *args, **options)
        made.append(weakref.ref(self))

    monkeypatch.setattr(World, "__init__", begun)
    yield
    for world in filter(None, (one() for one in made)):
        world.close()
