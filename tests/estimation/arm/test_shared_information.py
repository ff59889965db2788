"""Information shared between joints: separate fits equal the joint fit."""

import numpy as np
import pytest

from palpate.estimation.arm.inertial_parameters import base_parameters
from palpate.estimation.channel import Information
from palpate.estimation.shared_gains import (
    arrange_products,
    information_of_others,
    shared_information,
    urdf_information,
)
from tests.estimation.arm.panda import JOINTS, colored_noise, minimum, motion, other_bodies, panda, regressor

FOLDS = 4
SIGMA = np.array([0.3, 0.5, 0.2, 0.3, 0.05, 0.1, 0.02])
EXTRA = {
    0: ["viscous", "coulomb"],
    1: ["viscous"],
    2: [],
    3: ["viscous", "coulomb"],
    4: ["coulomb"],
    5: [],
    6: ["viscous"],
}


class SharedArm:
    def __init__(self):
        rng, self.body = np.random.default_rng(7), panda()
        self.base = base_parameters(self.body)
        (q, v, a), self.fold = motion(rng, runs=FOLDS, seconds=6.0, rate_hz=50.0)
        shapes = {"viscous": v, "coulomb": np.sign(v)}
        self.own = [
            np.column_stack([np.zeros((len(q), 0)), *(shapes[e][:, j] for e in EXTRA[j])])
            for j in range(JOINTS)
        ]
        self.columns = regressor(self.body, q, v, a)[:, :, self.base.columns]
        self.torque = self.columns @ (self.base.grouping @ other_bodies(rng, self.body.parameters))
        self.torque += 0.4 * np.sign(v) + SIGMA * colored_noise(rng, self.fold, JOINTS)
        self.prior = urdf_information(self.base, self.body.parameters)
        self.products = [self.products_of(j, self.columns[:, j], self.own[j]) for j in range(JOINTS)]
        self.information = [self.of_joint(j, self.products[j]) for j in range(JOINTS)]

    def products_of(self, joint, shared, own, torque=None):
        rows = np.column_stack([shared, own, (self.torque if torque is None else torque)[:, joint]])
        parts = [rows[self.fold == f] for f in range(FOLDS)]
        return np.stack([part.T @ part for part in parts])

    def of_joint(self, joint, products, more=0):
        return shared_information(products, len(self.base.columns) + more, SIGMA[joint])

    def stacked(self, used):
        """All gains by least squares of all joints' rows, the prior as more rows: an independent way."""
        b, sizes = len(self.base.columns), [own.shape[1] for own in self.own]
        starts = b + np.cumsum([0, *sizes])
        blocks, targets = [], []
        for j in range(JOINTS):
            block = np.zeros((used.sum(), starts[-1]))
            block[:, :b], block[:, starts[j] : starts[j + 1]] = (self.columns[used, j], self.own[j][used])
            blocks.append(block / SIGMA[j])
            targets.append(self.torque[used, j] / SIGMA[j])
        root = np.linalg.cholesky(self.prior.matrix).T
        blocks.append(np.column_stack([root, np.zeros((b, starts[-1] - b))]))
        targets.append(np.linalg.solve(root.T, self.prior.vector))
        columns, target = np.concatenate(blocks), np.concatenate(targets)
        scale = np.linalg.norm(columns, axis=0)
        gains = np.linalg.lstsq(columns / scale, target, rcond=None)[0] / scale
        return gains[:b], [gains[starts[j] : starts[j + 1]] for j in range(JOINTS)]


@pytest.fixture(scope="module")
def arm():
    return SharedArm()


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("joint", range(JOINTS))
def test_one_joint_with_shared_information_matches_the_joint_fit(arm, joint):
    others = information_of_others(arm.information, arm.prior)[joint]
    products = arm.products[joint]
    total = np.concatenate([[products.sum(axis=0)], products.sum(axis=0) - products]) / SIGMA[joint] ** 2
    b = len(arm.base.columns)
    system = total[:, :-1, :-1].copy()
    right = total[:, :-1, -1].copy()
    system[:, :b, :b] += others.matrix
    right[:, :b] += others.vector
    gains = minimum(Information(system, right))
    training = [np.ones(len(arm.fold), bool), *(arm.fold != f for f in range(FOLDS))]
    for one, used in zip(gains, training, strict=True):
        shared, own = arm.stacked(used)
        close(one[:b], shared)
        if EXTRA[joint]:
            close(one[b:], own[joint])
    # Fitted with those alone, not divided by its noise, it predicts held-out folds as all together.
    felt = np.flatnonzero(arm.base.affects_joint[joint])
    others = others.about(felt).times(SIGMA[joint] ** 2)
    columns = np.column_stack([arm.columns[:, joint][:, felt], arm.own[joint]])
    for f in range(FOLDS):
        used, s = arm.fold != f, len(felt)
        system, right = columns[used].T @ columns[used], columns[used].T @ arm.torque[used, joint]
        system[:s, :s] += others.matrix[1 + f]
        right[:s] += others.vector[1 + f]
        gains = minimum(Information(system, right))
        shared, own = arm.stacked(used)
        held = ~used
        expected = arm.columns[held, joint] @ shared + arm.own[joint][held] @ own[joint]
        close(columns[held] @ gains, expected)


def test_moments_in_another_order_are_equivalent(arm):
    joint, names = 4, list(arm.base.names)
    felt = [names[i] for i in np.flatnonzero(arm.base.affects_joint[joint])]
    mixed = ["coulomb", *reversed(felt)]
    picked = {
        **{name: arm.columns[:, joint, i] for i, name in enumerate(names)},
        "coulomb": arm.own[joint][:, 0],
    }
    rows = np.column_stack([*(picked[name] for name in mixed), arm.torque[:, joint]])
    products = np.stack([rows[arm.fold == f].T @ rows[arm.fold == f] for f in range(FOLDS)])
    found = arrange_products(products, mixed, names)
    np.testing.assert_allclose(found, arm.products[joint], atol=1e-9)


def test_shared_parameters_without_masses_need_no_prior(arm):
    """A coupling of joints 5 and 6, in one fit of joint 5 with what the others know."""
    rng, coupled = np.random.default_rng(8), np.zeros((len(arm.fold), JOINTS, 1))
    coupled[:, 4, 0], coupled[:, 5, 0] = rng.normal(size=(2, len(arm.fold)))
    columns = np.concatenate([arm.columns, coupled], axis=2)
    torque = arm.torque + 0.5 * coupled[:, :, 0]
    products = (arm.products_of(j, columns[:, j], arm.own[j], torque) for j in range(JOINTS))
    known = [arm.of_joint(j, each, more=1) for j, each in enumerate(products)]
    unknown = Information(np.pad(arm.prior.matrix, (0, 1)), np.pad(arm.prior.vector, (0, 1)))
    both = information_of_others(known, unknown)[4] + known[4]
    assert minimum(both)[:, -1] == pytest.approx(0.5, abs=0.01)


def test_dependent_own_columns_do_no_harm(arm):
    """Viscous friction twice says no more of the base parameters than once."""
    twice = arm.of_joint(1, arm.products_of(1, arm.columns[:, 1], np.repeat(arm.own[1], 2, axis=1)))
    one, two = (
        information_of_others([known, arm.information[2]], arm.prior)[1]
        for known in (arm.information[1], twice)
    )
    close(minimum(two), minimum(one))
