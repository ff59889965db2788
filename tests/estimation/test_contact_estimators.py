"""Contact law estimators: one form for all, and the purpose of each."""

import numpy as np
import pytest

from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.estimator import ContactEstimator, ContactLaw, OnlineContactLaw
from palpate.estimation.models import MODELS
from palpate.estimation.online import OnlineContactEstimator
from palpate.robot_io.errors import InputError
from tests.estimation.little_probe import hunt_crossley, kelvin_voigt, probe

EVERY = pytest.mark.parametrize("name", list(CONTACT_ESTIMATORS))
HUNT_CROSSLEY = ContactLaw(8000.0, 4000.0, 1.5, 1.5)
ONLINE = [name for name, each in CONTACT_ESTIMATORS.items() if issubclass(each, OnlineContactLaw)]
FROM_LOGARITHMS = ["log_linear_ewrls", "hybrid_sprls"]


def press(law, *, count=6000, noise_n=0.0, outliers=0.0, seed=0):
    """Depth, speed and force of a swing of rising frequency, always in contact."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) * 1e-3
    phase = 2 * np.pi * (t + 0.2 * t**2)
    depth = 0.002 + 0.005 * (1 - np.cos(phase))
    speed = 0.005 * np.sin(phase) * 2 * np.pi * (1 + 0.4 * t)
    k, b, n, m, _ = law
    force = k * depth**n + b * depth**m * speed + noise_n * rng.standard_normal(count)
    wrong = rng.random(count) < outliers
    return depth, speed, np.where(wrong, force + rng.uniform(-1.0, 4.0, count), force)


def found(name, data, **settings):
    return CONTACT_ESTIMATORS[name](**settings).fit(*data, rng=np.random.default_rng(0))


@EVERY
def test_estimator_has_metadata_and_repeats_the_stiffness_of_its_law(name):
    estimator = CONTACT_ESTIMATORS[name]
    assert issubclass(estimator, ContactEstimator)
    assert estimator.name == name
    assert estimator.model in MODELS
    assert "Source: " in estimator.__doc__
    # Damping is left out: the model-reference one knows none.
    truth = HUNT_CROSSLEY if CONTACT_ESTIMATORS[name].model == "hunt_crossley" else ContactLaw(500.0, 0.0)
    truth = truth._replace(damping=0.0)
    law = found(name, press(truth, noise_n=0.005))
    assert law.compliance(0.008)[0] == pytest.approx(truth.compliance(0.008)[0], rel=0.08)
    data = press(HUNT_CROSSLEY, count=400, noise_n=0.01)
    before = [values.copy() for values in data]
    estimator = CONTACT_ESTIMATORS[name]()
    first, second = (estimator.fit(*data, rng=np.random.default_rng(3)) for _ in range(2))
    assert first == second
    for values, kept in zip(data, before, strict=True):
        np.testing.assert_array_equal(values, kept)


@pytest.mark.parametrize("name", ["double_stage_rls", "robust_hunt_crossley", *FROM_LOGARITHMS])
def test_samples_without_contact_are_refused(name):
    away = np.full(50, -0.01)
    with pytest.raises(InputError, match="in contact"):
        found(name, (away, away, np.zeros(50)))


@pytest.mark.parametrize("name", ["robust_hunt_crossley", "reduced_kalman", *FROM_LOGARITHMS])
def test_hunt_crossley_is_recovered(name):
    law = found(name, press(HUNT_CROSSLEY, noise_n=0.01))
    assert law.exponent == pytest.approx(1.5, abs=0.01)
    assert law.stiffness == pytest.approx(8000.0, rel=0.03)
    assert law.damping == pytest.approx(4000.0, rel=0.05)


def test_two_stages_improve_with_time_and_logarithms_forget_the_last_object():
    soft, stiff = press(HUNT_CROSSLEY), press(ContactLaw(16000.0, 8000.0, 1.5, 1.5))
    both = tuple(map(np.concatenate, zip(soft, stiff, strict=True)))
    assert found("log_linear_ewrls", both).stiffness == pytest.approx(16000.0, rel=0.05)
    assert found("log_linear_ewrls", both, forgetting=1.0).stiffness < 14000.0
    laws = CONTACT_ESTIMATORS["double_stage_rls"]().follow(*press(HUNT_CROSSLEY, count=12_000))
    errors = [abs(laws[at].exponent - 1.5) for at in (300, 3000, 11_000)]
    assert errors[0] > errors[1] > errors[2]


def test_kalman_filter_finds_the_surface_and_the_noise():
    depth, speed, force = press(HUNT_CROSSLEY, noise_n=0.01)
    law = found("reduced_kalman", (depth - 2e-4, speed, force))
    assert law.surface_m == pytest.approx(-2e-4, abs=1e-5)
    assert law.stiffness == pytest.approx(8000.0, rel=0.02)
    # A filter that holds a noise of 0.1 N for true follows 1 N as if it were a signal.
    depth, speed, force = press(HUNT_CROSSLEY, noise_n=1.0)
    laws = CONTACT_ESTIMATORS["reduced_kalman"]().follow(depth, speed, force)
    late = np.array([law.stiffness for law in laws[-2000:]])
    assert np.std(late) < 0.01 * 8000.0
    assert np.mean(late) == pytest.approx(8000.0, rel=0.03)


def test_hybrid_uses_the_linear_law_on_stiff_objects():
    stiff = found("hybrid_sprls", press(ContactLaw(3000.0, 40.0), noise_n=0.01))
    assert (stiff.exponent, stiff.damping_exponent) == (1.0, 0.0)
    assert stiff.stiffness == pytest.approx(3000.0, rel=0.01)
    assert stiff.damping == pytest.approx(40.0, rel=0.05)
    assert found("hybrid_sprls", press(ContactLaw(2000.0, 1500.0, 1.3, 1.3))).exponent > 1.2


def test_gradient_estimator_needs_excitation():
    """At rest all that can be learnt is one sum of stiffness and damping's share."""
    law = found("indirect_adaptive", press(ContactLaw(500.0, 20.0), noise_n=0.01))
    assert law.stiffness == pytest.approx(500.0, rel=0.02)
    assert law.damping == pytest.approx(20.0, rel=0.05)
    still = np.full(6000, 0.008), np.zeros(6000), np.full(6000, 4.0)
    assert found("indirect_adaptive", still).damping == 0.0


def test_reference_model_tolerates_a_biased_sensor():
    depth, speed, force = press(ContactLaw(500.0, 0.0), noise_n=0.01)
    law = found("model_reference", (depth, speed, force + 3.0))
    assert law.stiffness == pytest.approx(500.0, rel=0.02)


@pytest.mark.parametrize("name", ONLINE)
def test_online_estimators_follow_a_probing_arm(name):
    """Felt stiffness and damping of Hunt-Crossley or Kelvin-Voigt, from the raw samples of a probe."""
    nonlinear = CONTACT_ESTIMATORS[name].model == "hunt_crossley"
    recorded = probe(hunt_crossley(5000.0, 8000.0, 1.4) if nonlinear else kelvin_voigt(500.0, 20.0))
    online = OnlineContactEstimator(CONTACT_ESTIMATORS[name]())
    samples = zip(recorded.time_s.tolist(), recorded.along_m.tolist(), recorded.force_n.tolist(), strict=True)
    estimates = np.array([online.update(*sample) for sample in samples])
    held = np.flatnonzero((recorded.phase == 4) & (recorded.run == 2))[-1]
    depth = recorded.true_along_m[held] - 0.4321
    expected = 5000.0 * 1.4 * depth**0.4 if nonlinear else 500.0
    assert estimates[held, 0] == pytest.approx(expected, rel=0.35)


@EVERY
@pytest.mark.parametrize("bad", [np.nan, None])
def test_unusable_samples_are_refused(name, bad):
    depth, speed, force = np.linspace(1e-3, 1e-2, 50), np.full(50, 0.01), np.linspace(0.1, 5.0, 50)
    if bad is None:
        speed = speed[:-1]
    else:
        force[20] = bad
    with pytest.raises(InputError, match=f"{name}: .*(give equal numbers|not finite)"):
        CONTACT_ESTIMATORS[name]().fit(depth, speed, force, rng=np.random.default_rng(1))
