"""Every test of the simulated world runs in each physics engine."""

import pytest

from sim_backend import engines


@pytest.fixture(params=sorted(engines._ENGINES), autouse=True)
def engine(request, monkeypatch):
    """Name of the engine that scenarios choose by default."""
    chosen = engines._ENGINES[request.param]
    pytest.importorskip(chosen[0])
    monkeypatch.setattr(engines, "_ENGINES", {request.param: chosen} | engines._ENGINES)
    return request.param
