"""Parameters that are fixed, bounded or evaluated, and a model beside the measurement."""

import re

import numpy as np
import pytest

from palpate.estimation.study import ModelStudy
from palpate.robot_io.errors import InputError
from tests.estimation.fits import MODEL, compare, cubic
from tests.estimation.presses import session


def presses(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Four presses of a spring of 400 N/m that stiffens, with a damper of 3 N s/m."""
    t, runs = np.arange(0, 1, 0.002), []
    for run, speed in enumerate((6.0, 9.0, 12.0, 15.0)):
        x, v = 0.004 * (1 - np.cos(speed * t)) - 0.001, 0.004 * speed * np.sin(speed * t)
        force = np.where(x > 0, 400 * x + 3 * v + 3e6 * x**3, 0).clip(0) + rng.normal(0, 0.02, len(t))
        runs.append({"time_s": t, "displacement_m": x, "force_N": force, "run": np.full(len(t), run)})
    return {name: np.concatenate([run[name] for run in runs]) for name in runs[0]}


@pytest.fixture(scope="module")
def study() -> ModelStudy:
    return ModelStudy(presses(np.random.default_rng(1)))


def test_fixed_parameters_stay_and_the_others_compensate(study):
    free = study.fit("contact", ["cubic_stiffness"])
    held = study.fit_held("contact", ["cubic_stiffness"], {"stiffness.k": 350.0})
    assert re.search(r"stiffness\.k +350 N/m +held\n", str(held))
    assert held.values["stiffness.k"] == 350.0
    assert held.parameters["stiffness.k"].std_err == 0.0
    assert held.values["cubic_stiffness.k3"] > free.values["cubic_stiffness.k3"]  # stiffens more instead
    assert held.rmse > free.rmse
    held = study.fit_held(
        "contact", ["cubic_stiffness"], {"damping.c": free.solution.parameters["damping.c"]}
    )
    for name in ("stiffness.k", "cubic_stiffness.k3"):
        assert held.solution.parameters[name] == pytest.approx(free.solution.parameters[name], rel=1e-6)
    assert held.parameters["stiffness.k"].std_err < 1.01 * free.parameters["stiffness.k"].std_err
    held = study.fit_held("contact", ["delay"], {"delay.time": 0.004})
    assert held.values["delay.time"] == 0.004
    assert held.rmse >= study.fit("contact", ["delay"]).rmse * 0.999
    assert study.fit_held("contact", (), bounds={"stiffness.k": (0.0, 1e6)}) is study.fit("contact")
    narrow = study.fit_held("contact", (), bounds={"stiffness.k": (0.0, 200.0)})
    assert narrow.values["stiffness.k"] == 200.0


@pytest.mark.parametrize(
    ("held", "said"),
    [
        ({"spring.k": 1.0}, "no parameter 'spring.k'"),
        ({"stiffness.k": float("nan")}, "finite"),
        ({"stiffness.k": "400"}, "finite"),
    ],
)
def test_invalid_fixed_parameters_are_refused(study: ModelStudy, held: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        study.fit_held("contact", (), held)


def test_reversed_bounds_are_refused(study: ModelStudy) -> None:
    with pytest.raises(InputError, match=r"stiffness.k: the bounds are 5 and 1; give the lower bound first"):
        study.fit_held("contact", (), {}, {"stiffness.k": (5.0, 1.0)})


def test_evicted_fits_are_reproduced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.estimation.study.fits._MAX_FITS", 2)
    study = ModelStudy(presses(np.random.default_rng(2)))
    first = study.fit("contact", ["delay"]).rmse
    for effect in ("adhesion", "contact_offset", "quadratic_damping"):
        study.fit("contact", [effect])
    assert len(study._fits) == 2
    assert study.fit("contact", ["delay"]).rmse == first


@pytest.fixture(scope="module")
def stiffening():
    return compare(session(4, cubic), MODEL)


def test_comparison_locates_a_missing_stiffening_and_refuses_rejected_data(stiffening):
    found = stiffening
    assert found.lack_of_fit > 3.0
    assert {"run", "direction", "speed", "depth", "effort"} <= set(found.parts)
    assert sum(part.energy for part in found.parts["run"]) == pytest.approx(1.0)
    deepest = found.parts["depth"][-1]
    assert deepest.mean > 0.0  # the measurement is above a straight line where it is deepest
    assert "times the noise" in found.words[0]
    assert any("depth" in words or "effort" in words for words in found.words[1:])
    found = compare(session(4), MODEL)
    assert found.lack_of_fit == pytest.approx(1.0, abs=0.05)
    assert "noise" in found.words[0]
    assert np.nanstd(found.fitted.residual) == pytest.approx(0.05, rel=0.1)
    with pytest.raises(InputError, match="samples"):
        compare(session(4).select(np.arange(20)), MODEL)


def test_excluded_samples_are_reported_and_not_scored(stiffening):
    found = stiffening
    left_out = np.count_nonzero(~found.scored)
    assert np.array_equal(found.scored, np.isfinite(found.fitted.residual))
    assert 0 < left_out < 0.1 * len(found.scored)
    assert found.exclusion_note.startswith(f"{left_out:,} of {len(found.scored):,} samples (")
    assert sum(part.samples for part in found.parts["run"]) == np.count_nonzero(found.scored)
    assert found.exclusion_note in found._repr_html_()
