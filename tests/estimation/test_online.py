import numpy as np
import pytest

from palpate.control.laws.gains import TouchGains
from palpate.control.loop.task import Phase, TaskOutput
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.estimators.ransac import PreemptiveRansac
from palpate.estimation.estimators.recursive import CusumRls, Rls, Sprls
from palpate.estimation.online import OnlineContactEstimator
from palpate.robot_io.types import Command, Measurement, Status
from tests.estimation.little_probe import kelvin_voigt, probe

SURFACE_M = 0.4321


def follow(recorded, estimator=None, **settings):
    """Estimates after each sample, shape (n, 3)."""
    online = OnlineContactEstimator(estimator or Rls(), **settings)
    return np.array([online.update(*sample) for sample in samples_of(recorded)])


def samples_of(recorded):
    """Time, place and force, sample by sample."""
    return zip(recorded.time_s.tolist(), recorded.along_m.tolist(), recorded.force_n.tolist(), strict=True)


@pytest.mark.parametrize(("stiffness", "damping"), [(300.0, 0.0), (500.0, 100.0), (2000.0, 20.0)])
@pytest.mark.parametrize("name", ["rls", "sprls"])
def test_estimator_converges_to_stiffness_damping_and_surface(stiffness, damping, name):
    found = follow(probe(kelvin_voigt(stiffness, damping), surface_m=SURFACE_M), ESTIMATORS[name]())[-1]
    assert found[0] == pytest.approx(stiffness, rel=0.01)
    assert found[1] == pytest.approx(damping, rel=0.02, abs=0.3)
    assert found[2] == pytest.approx(SURFACE_M, abs=1e-4)


def test_no_estimate_is_given_before_enough_samples():
    recorded = probe(kelvin_voigt(500.0, 20.0))
    known = np.isfinite(follow(recorded)[:, 0])
    first = int(np.argmax(known))
    assert known[first:].all()
    touch = int(np.argmax(recorded.force_n > 0.3))
    assert touch + 30 < first < touch + 80


def test_biased_sensor_is_tared_in_free_air():
    recorded = probe(kelvin_voigt(800.0, 30.0), surface_m=SURFACE_M)
    recorded.force_n = recorded.force_n + 0.8
    found = follow(recorded)[-1]
    assert found[0] == pytest.approx(800.0, rel=0.01)
    assert found[2] == pytest.approx(SURFACE_M, abs=1e-4)


def tick(time_s, along_m, force_n):
    """What was measured and aimed at when the tool presses down."""
    joints, down = np.zeros(3), np.array([0.0, 0.0, -1.0])
    measurement = Measurement(time_s, joints, joints, joints, force_n, time_s, time_s, time_s)
    output = TaskOutput(Command(joints), joints, joints, along_m * down, joints, down, 10.0, Phase.LOADING)
    return measurement, output


def test_stale_ticks_are_skipped():
    recorded = probe(kelvin_voigt(800.0, 30.0), surface_m=SURFACE_M)
    online = OnlineContactEstimator(Rls())
    for index, sample in enumerate(samples_of(recorded)):
        measurement, output = tick(*sample)
        found = online.observe(measurement, output)
        stale = measurement._replace(force_status=Status.STALE, force_n=1e3)
        if index % 3 == 0:
            assert online.observe(stale, output) == found or np.isnan(found).all()
    assert found[0] == pytest.approx(800.0, rel=0.01)
    assert found[2] == pytest.approx(SURFACE_M, abs=1e-4)


def test_overrun_does_not_make_a_false_velocity():
    recorded = probe(kelvin_voigt(800.0, 30.0))
    kept = np.ones(len(recorded.time_s), bool)
    kept[700:-1:23] = False
    for name, values in vars(recorded).items():
        setattr(recorded, name, values[kept])
    found = follow(recorded)[-1]
    assert found[0] == pytest.approx(800.0, rel=0.01)
    assert found[1] == pytest.approx(30.0, rel=0.02)


@pytest.mark.parametrize(("noise_n", "still_touching"), [(0.02, True), (0.1, False)])
def test_touch_and_release_thresholds_grow_with_the_sensor_noise(noise_n, still_touching):
    """0.2 N is above half of the touch force of a quiet sensor, and below half of that of a noisy one."""
    online = OnlineContactEstimator(Rls())
    air_n = noise_n * np.resize([1.0, -1.0], 200)
    for number, force_n in enumerate(np.concatenate([air_n, np.full(50, 5.0), np.full(5, 0.2)])):
        online.update(1e-3 * number, 1e-4 * number, float(force_n))
        if number == 220:
            assert online.in_contact
    assert online.in_contact is still_touching


def test_touch_force_of_the_robot_applies():
    gentle, firm = (OnlineContactEstimator(Rls(), TouchGains(touch_force_n=force)) for force in (0.3, 2.0))
    for online in (gentle, firm):
        for number, force_n in enumerate([0.0] * 50 + [1.0] * 5):
            online.update(1e-3 * number, 1e-4 * number, force_n)
    assert gentle.in_contact
    assert not firm.in_contact


DAMPING = 20.0
CHANGE = 3000


def excited(stiffness, *, share=0.0, noise_n=0.005, outliers=0.0, seed=0):
    """Rows and forces of a motion of 5 and 8 Hz; `stiffness` (n,) of each sample."""
    rng = np.random.default_rng(seed)
    t = np.arange(len(stiffness)) * 1e-3
    depth = 0.008 + 0.004 * np.sin(10 * np.pi * t) + 0.0025 * np.sin(16 * np.pi * t + 1)
    rows = np.column_stack([depth, np.gradient(depth, 1e-3)])
    force = stiffness * depth + DAMPING * rows[:, 1]
    measured = force + np.hypot(noise_n, share * force) * rng.standard_normal(len(t))
    wrong = rng.random(len(t)) < outliers
    return rows, np.where(wrong, measured + rng.uniform(-1.0, 4.0, len(t)), measured)


def follow_change(estimator, rows, forces):
    estimator.start(rows.shape[1])
    return np.array(
        [estimator.update(row, force)[0] for row, force in zip(rows, forces.tolist(), strict=True)]
    )


def stepped(count=4000):
    return np.where(np.arange(count) < CHANGE, 500.0, 1000.0)


@pytest.mark.parametrize("noise", [{"noise_n": 0.02}, {"share": 0.02}, {"share": 0.1}])
def test_step_is_tracked_within_100_ms(noise):
    late = [
        follow_change(CusumRls(), *excited(stepped(), seed=seed, **noise))[CHANGE + 100] for seed in range(3)
    ]
    np.testing.assert_allclose(late, 1000.0, rtol=0.05)


def test_cusum_rls_is_least_squares_without_a_change_and_steadier_than_sprls():
    data = excited(np.full(CHANGE, 500.0), share=0.1)
    calm, perturbed = (np.var(follow_change(each, *data)[1500:]) for each in (CusumRls(), Sprls()))
    assert calm < 0.25 * perturbed
    data = excited(np.full(2000, 500.0), noise_n=0.02)
    np.testing.assert_allclose(follow_change(CusumRls(), *data), follow_change(ESTIMATORS["rls"](), *data))


def test_consensus_ignores_outliers_and_a_new_one_takes_over():
    data = excited(np.full(2000, 500.0), noise_n=0.02, outliers=0.3)
    assert follow_change(PreemptiveRansac(), *data)[-1] == pytest.approx(500.0, rel=0.005)
    assert abs(follow_change(ESTIMATORS["rls"](), *data)[-1] - 500.0) > 10.0
    data = excited(stepped(), noise_n=0.02, outliers=0.2)
    found = follow_change(PreemptiveRansac(), *data)
    assert found[CHANGE - 1] == pytest.approx(500.0, rel=0.01)
    assert found[CHANGE + 400] == pytest.approx(1000.0, rel=0.01)
