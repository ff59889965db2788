"""Base parameters and pseudo-inertias."""

from pathlib import Path

import numpy as np
import pytest

from palpate import sim_backend
from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.arm.inertial_parameters import (
    Divergence,
    base_parameters,
    inertial_of,
    nearest_bodies,
    pseudo_inertias,
)
from palpate.estimation.channel import Information
from palpate.estimation.shared_gains import consistent_information, fit_bodies, urdf_information
from tests.estimation.arm.panda import is_body, minimum, other_bodies, panda

FOLLOWER = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"


def point_masses(rng, count=6):
    """Parameters of a heap of point masses, by their definition."""
    m, x = rng.uniform(0.1, 1.0, count), rng.normal(size=(count, 3))
    inertia = sum(
        mass * (place @ place * np.eye(3) - np.outer(place, place)) for mass, place in zip(m, x, strict=True)
    )
    return np.array([m.sum(), *(m @ x), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


@pytest.fixture(scope="module", params=["panda", "follower"])
def body(request):
    return panda() if request.param == "panda" else RigidBody.from_urdf(FOLLOWER, "tip")


def test_base_parameters_reproduce_every_torque(body):
    base, phi = base_parameters(body), body.parameters
    for q, v, a in np.random.default_rng(5).uniform(-3, 3, (20, 3, body.joint_count)):
        regressor = body.regressor(q, v, a)
        torque = regressor[:, base.columns] @ (base.grouping @ phi)
        np.testing.assert_allclose(torque, body.inverse_dynamics(q, v, a), atol=1e-9)
        unfelt = ~base.affects_joint
        assert np.abs(regressor[:, base.columns][unfelt]).max(initial=0.0) < 1e-9


def test_base_parameters_are_independent_and_agree_with_pseudo_inertias():
    base = base_parameters(panda())
    # Seven joints, none parallel, first axis vertical: Khalil and Dombre, ch. 9.
    assert len(base.columns) == 43
    assert np.linalg.matrix_rank(base.grouping) == 43
    assert len(set(base.names)) == 43
    phi = np.concatenate([point_masses(np.random.default_rng(seed)) for seed in range(3)])
    np.testing.assert_allclose(inertial_of(pseudo_inertias(phi)), phi, atol=1e-12)


def test_pseudo_inertia_is_positive_for_physical_bodies():
    rng = np.random.default_rng(1)
    for _ in range(20):
        heap = point_masses(rng)
        assert is_body(heap)
        np.testing.assert_allclose(nearest_bodies(heap), heap, rtol=1e-6, atol=1e-12)
    heavy_z = np.array([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.3])  # Izz > Ixx + Iyy
    # less inertia than its mass has at its center
    for wrong in (heavy_z, np.array([1.0, 1.0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]), -heap, np.zeros(10)):
        assert not is_body(wrong)
        assert is_body(nearest_bodies(wrong))


def test_divergence_gradient_and_hessian_match_finite_differences():
    rng = np.random.default_rng(2)
    origin, at = (np.concatenate([point_masses(rng), point_masses(rng)]) for _ in range(2))
    divergence, step = Divergence(origin), 1e-5
    steps = step * np.eye(20)
    slope = [(divergence.value(at + s) - divergence.value(at - s)) / (2 * step) for s in steps]
    curve = [(divergence.gradient(at + s) - divergence.gradient(at - s)) / (2 * step) for s in steps]
    np.testing.assert_allclose(divergence.gradient(at), slope, rtol=1e-6, atol=1e-6)
    root = divergence.curvature_root(at)
    np.testing.assert_allclose(root.T @ root, curve, rtol=1e-5, atol=1e-5)
    assert divergence.value(origin) == pytest.approx(0.0, abs=1e-10)
    assert divergence.value(at) > 0.0
    assert divergence.value(-at) == np.inf


def test_divergence_is_independent_of_units():
    rng = np.random.default_rng(3)
    one, two = point_masses(rng), point_masses(rng)
    units = np.repeat([1e3, 1e6, 1e9], [1, 3, 6])
    assert Divergence(one * units).value(two * units) == pytest.approx(Divergence(one).value(two), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_best_bodies_minimize_the_penalized_error(scale):
    """No small change of the bodies lowers the cost, from hardly any data to nearly no noise."""
    rng = np.random.default_rng(4)
    origin = np.concatenate([point_masses(np.random.default_rng(seed)) for seed in (1, 2)])
    rows = rng.normal(size=(12, 20))  # not enough to determine all
    target = rows @ other_bodies(rng, origin, 0.5) - 3.0  # and partly what no bodies would do
    information = Information(scale * rows.T @ rows, scale * rows.T @ target)
    divergence = Divergence(origin)
    best = fit_bodies(information, divergence, 1.0)

    def cost(phi):
        return 0.5 * scale * np.sum((rows @ phi - target) ** 2) + divergence.value(phi)

    assert is_body(best)
    factor = np.linalg.cholesky(pseudo_inertias(best))
    for _ in range(100):
        change = 1e-3 * rng.normal(size=(2, 4, 4))
        near = inertial_of(
            factor @ (np.eye(4) + change + change.transpose(0, 2, 1)) @ factor.transpose(0, 2, 1)
        )
        assert cost(near) > cost(best)


def test_prior_expanded_at_the_best_bodies_leads_a_linear_fit_to_them():
    body = panda()
    base, rng = base_parameters(body), np.random.default_rng(6)
    rows = rng.normal(size=(30, len(base.columns)))  # 30 equations for 43 parameters
    target = rows @ (base.grouping @ other_bodies(rng, body.parameters)) - 1.0
    data = Information(rows.T @ rows, rows.T @ target)
    onto = Information(base.grouping.T @ data.matrix @ base.grouping, base.grouping.T @ data.vector)
    best = fit_bodies(onto, Divergence(nearest_bodies(body.parameters)), 1.0)
    linear = minimum(data + urdf_information(base, body.parameters, at=best))
    np.testing.assert_allclose(linear, base.grouping @ best, atol=1e-6 * np.abs(linear).max())
    several = Information(data.matrix[None], data.vector[None])
    pull = consistent_information(base, body.parameters, several)
    np.testing.assert_allclose(minimum(several + pull)[0], linear, rtol=1e-6)
