"""A seven-joint arm of other masses than its URDF's, with friction in some joints."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.arm.base_parameters import base_parameters
from estimation.arm.held_out import held_out
from estimation.arm.identify import identify
from estimation.arm.pseudo_inertia import is_consistent, nearest_bodies
from estimation.arm.rows import ArmRows, arm_rows
from robot_io.errors import InputError
from tests.estimation.arm.panda import JOINTS, coloured_noise, motion, other_bodies, panda

SIGMA = 0.3 * np.array([1, 1, 0.7, 0.7, 0.2, 0.2, 0.1])
VISCOUS = np.array([2.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.2])
COULOMB = np.array([1.5, 0.0, 0.8, 0.0, 0.4, 0.0, 0.1])
BODY = panda()
BASE = base_parameters(BODY)


def rows_along(path, run, **options):
    velocity = path[1]
    own = [np.column_stack([velocity[:, j], np.sign(velocity[:, j])]) for j in range(JOINTS)]
    return arm_rows(BODY, BASE, path, np.zeros_like(velocity), run=run, own=own, **options)


def measured(rng, rows, bodies, noise=1.0):
    """With the torques of these bodies, the frictions, and noise that is correlated in time."""
    friction = [
        own @ gains for own, gains in zip(rows.own, np.stack([VISCOUS, COULOMB], axis=1), strict=True)
    ]
    torque = rows.regressor @ (BASE.grouping @ bodies) + np.column_stack(friction)
    return replace(rows, torque=torque + noise * SIGMA * coloured_noise(rng, rows.run, JOINTS))


@pytest.fixture(scope="module")
def well_excited():
    return rows_along(*motion(np.random.default_rng(0), rate_hz=50.0))


@pytest.fixture(scope="module")
def poorly_excited():
    """Only two joints move, and little."""
    return rows_along(*motion(np.random.default_rng(1), rate_hz=50.0, size=0.3, moving=(1, 3)))


def test_intervals_hold_the_truth(well_excited):
    """Of 25 other arms, base parameters and friction; 3 standard errors of the share of 95 % is 91 %."""
    rng, held = np.random.default_rng(2), []
    for _ in range(25):
        bodies = other_bodies(rng, BODY.parameters)
        found = identify(measured(rng, well_excited, bodies), BASE, BODY.parameters)
        assert is_consistent(found.inertial)
        truth = np.concatenate([BASE.grouping @ bodies, np.stack([VISCOUS, COULOMB], axis=1).ravel()])
        intervals = np.concatenate([[one.interval for one in found.base_estimates], *found.own_intervals])
        held.append((intervals[:, 0] <= truth) & (truth <= intervals[:, 1]))
    assert 0.91 < np.mean(held) < 0.99
    assert np.mean(held, axis=0).min() > 0.6  # no single parameter is always off


def test_noise_of_each_joint_is_found_and_friction_where_it_is(well_excited):
    rng = np.random.default_rng(3)
    found = identify(measured(rng, well_excited, other_bodies(rng, BODY.parameters)), BASE, BODY.parameters)
    np.testing.assert_allclose(found.sigma, SIGMA, rtol=0.2)
    np.testing.assert_allclose([own[1] for own in found.own], COULOMB, atol=0.15)
    assert found.determined > 35


def test_exact_torques_give_the_exact_parameters(well_excited):
    bodies = other_bodies(np.random.default_rng(4), BODY.parameters)
    found = identify(
        measured(np.random.default_rng(4), well_excited, bodies, noise=0.0), BASE, BODY.parameters
    )
    np.testing.assert_allclose(found.base, BASE.grouping @ bodies, atol=1e-5)
    np.testing.assert_allclose([own[1] for own in found.own], COULOMB, atol=1e-5)


def test_what_the_motion_does_not_show_stays_as_the_urdf_has_it(poorly_excited):
    rng = np.random.default_rng(5)
    found = identify(measured(rng, poorly_excited, other_bodies(rng, BODY.parameters)), BASE, BODY.parameters)
    assert is_consistent(found.inertial)
    assert found.determined < 30
    unknown = found.data_share < 1e-3
    assert unknown.sum() > 5
    urdf = nearest_bodies(BODY.parameters)
    width = np.diff(found.inertial_intervals, axis=1)[:, 0]
    assert np.abs(found.inertial - urdf)[unknown] == pytest.approx(0.0, abs=0.05 * width[unknown].max())
    assert (np.abs(found.inertial - urdf) < 0.05 * width)[unknown].all()


def test_held_out_runs_are_predicted_as_well_as_by_least_squares_or_better(well_excited, poorly_excited):
    for rows in (well_excited, poorly_excited):
        rng = np.random.default_rng(6)
        data = measured(rng, rows, other_bodies(rng, BODY.parameters), noise=3.0)
        found = held_out(data, BASE, BODY.parameters)
        reference = np.concatenate(
            [stacked_least_squares(data, data.run != run, data.run == run) for run in np.unique(data.run)]
        )
        ours = np.sqrt(np.mean((found.rmse / SIGMA) ** 2))
        assert ours <= 1.002 * np.sqrt(np.mean((reference / SIGMA) ** 2))
        assert ours < 3.3  # of a noise of 3


def stacked_least_squares(data, used, held):
    """Residuals in held-out rows of one plain least-squares fit of all joints, each divided by its noise."""
    own = np.zeros((len(data.run), JOINTS, 2 * JOINTS))
    for joint, columns in enumerate(data.own):
        own[:, joint, 2 * joint : 2 * joint + 2] = columns
    columns = np.concatenate([data.regressor, own], axis=2) / SIGMA[:, None]
    target = data.torque / SIGMA
    flat = columns[used].reshape(-1, columns.shape[2])
    scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
    gains = np.linalg.lstsq(flat / scale, target[used].ravel(), rcond=1e-6)[0] / scale
    return (target[held] - columns[held] @ gains) * SIGMA


def test_a_coupling_of_two_joints_is_one_parameter(well_excited):
    rng, coupled = np.random.default_rng(8), np.zeros((len(well_excited.run), JOINTS, 1))
    speed = np.array([well_excited.own[j][:, 0] for j in range(JOINTS)])
    coupled[:, 4, 0], coupled[:, 5, 0] = speed[5], speed[4]
    data = measured(rng, replace(well_excited, shared=coupled), other_bodies(rng, BODY.parameters))
    found = identify(replace(data, torque=data.torque + 0.7 * coupled[:, :, 0]), BASE, BODY.parameters)
    assert found.shared == pytest.approx([0.7], abs=0.1)
    assert found.shared_intervals[0, 0] < 0.7 < found.shared_intervals[0, 1]


def test_means_over_blocks_give_the_same_parameters():
    """Averaged ten to one, columns and torques alike."""
    path, run = motion(np.random.default_rng(9), rate_hz=500.0)
    bodies = other_bodies(np.random.default_rng(10), BODY.parameters)
    one = measured(np.random.default_rng(10), rows_along(path, run), bodies, noise=0.0)
    ten = rows_along(path, run, block=10)
    means = np.stack([one.torque[i : i + 10].mean(axis=0) for i in range(0, len(run), 10)])
    found = identify(replace(ten, torque=means), BASE, BODY.parameters)
    np.testing.assert_allclose(found.base, BASE.grouping @ bodies, atol=1e-5)


def test_blocks_stay_within_runs_and_leave_out_what_has_no_weight():
    path, run = motion(np.random.default_rng(11), runs=3, seconds=1.05)
    weights = np.ones_like(path[0])
    weights[7, 2] = 0.0
    rows = rows_along(path, run, block=10, weights=weights)
    assert rows.run.tolist() == [0] * 10 + [1] * 10 + [2] * 10
    assert rows.weights[0, 2] == 0.0
    assert rows.weights.sum() == 30 * JOINTS - 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: replace(rows, weights=0.0 * rows.weights), "samples cannot determine"),
        (lambda rows: replace(rows, regressor=rows.regressor[:, :, 1:]), "base parameters"),
        (lambda rows: replace(rows, own=rows.own[1:]), "own has"),
        (lambda rows: rows, "not measured"),
        (lambda rows: held_out(rows.of_runs(np.array([0])), BASE, BODY.parameters), "at least two"),
    ],
)
def test_says_what_it_cannot_do(well_excited, change, words):
    with pytest.raises(InputError, match=words):
        identify(change(well_excited), BASE, BODY.parameters)
    assert isinstance(well_excited, ArmRows)


def test_gains_that_nothing_shows_have_no_interval(poorly_excited):
    """Friction of joints that stand still, and one column given twice; all else keeps its interval."""
    rng = np.random.default_rng(12)
    own = [
        np.repeat(columns, 2, axis=1) if joint == 3 else columns
        for joint, columns in enumerate(poorly_excited.own)
    ]
    data = measured(rng, poorly_excited, other_bodies(rng, BODY.parameters))
    nothing = np.zeros((len(data.run), JOINTS, 1))
    found = identify(replace(data, own=tuple(own), shared=nothing), BASE, BODY.parameters)
    assert np.isnan(found.shared_intervals).all()
    known = [np.isfinite(intervals).all() for intervals in found.own_intervals]
    assert known == [False, True, False, False, False, False, False]
    assert all(np.isfinite(one.interval).all() for one in found.base_estimates)
    assert found.own_intervals[1][1, 0] < COULOMB[1] < found.own_intervals[1][1, 1]


def test_a_held_out_run_does_not_take_part_in_its_own_prediction(well_excited):
    """Whatever is added to the torque of one run is found again in its residual, in full."""
    rng = np.random.default_rng(13)
    data = measured(rng, well_excited, other_bodies(rng, BODY.parameters))
    held = data.run == 2
    change = np.where(held[:, None], data.regressor[:, :, 5] * 3.0, 0.0)
    one, two = (
        held_out(d, BASE, BODY.parameters) for d in (data, replace(data, torque=data.torque + change))
    )
    np.testing.assert_allclose((two.residual - one.residual)[held], change[held], atol=1e-9)
    assert np.all(two.rmse > one.rmse)
    assert 0.0 < one.relative < two.relative
