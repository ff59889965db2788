"""What joints tell each other: fitted one by one, they must find what all of them find together."""

import numpy as np
import pytest

from estimation.arm.base_parameters import base_parameters
from estimation.arm.normal_equations import (
    arranged,
    information_of_others,
    joint_moments,
    own_gains,
    shared_information,
    training_sums,
)
from estimation.arm.prior import urdf_information
from estimation.arm.rows import arm_rows
from estimation.information import Information
from tests.estimation.arm.panda import JOINTS, coloured_noise, motion, other_bodies, panda

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


class Arm:
    def __init__(self):
        rng, self.body = np.random.default_rng(7), panda()
        self.base = base_parameters(self.body)
        (q, v, a), self.fold = motion(rng, runs=FOLDS, seconds=6.0, rate_hz=50.0)
        shapes = {"viscous": v, "coulomb": np.sign(v)}
        own = [
            np.column_stack([np.zeros((len(q), 0)), *(shapes[e][:, j] for e in EXTRA[j])])
            for j in range(JOINTS)
        ]
        rows = arm_rows(self.body, self.base, (q, v, a), np.zeros_like(q), run=self.fold, own=own)
        torque = rows.regressor @ (self.base.grouping @ other_bodies(rng, self.body.parameters))
        torque += 0.4 * np.sign(v) + SIGMA * coloured_noise(rng, self.fold, JOINTS)
        self.rows, self.own, self.torque = rows, rows.own, torque
        self.prior = urdf_information(self.base, self.body.parameters)
        self.moments = [
            joint_moments(
                rows.regressor[:, j], own[j], torque[:, j], sigma=SIGMA[j], fold=self.fold, folds=FOLDS
            )
            for j in range(JOINTS)
        ]

    def stacked(self, used):
        """All gains by least squares of all joints' rows, the prior as more rows: an independent way."""
        b, sizes = len(self.base.columns), [own.shape[1] for own in self.own]
        starts = b + np.cumsum([0, *sizes])
        blocks, targets = [], []
        for j in range(JOINTS):
            block = np.zeros((used.sum(), starts[-1]))
            block[:, :b], block[:, starts[j] : starts[j + 1]] = (
                self.rows.regressor[used, j],
                self.own[j][used],
            )
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
    return Arm()


def training(arm):
    return [np.ones(len(arm.fold), bool), *(arm.fold != f for f in range(FOLDS))]


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("joint", range(JOINTS))
def test_one_joint_with_what_the_others_know_finds_what_all_find(arm, joint):
    others = information_of_others(arm.moments, arm.prior)[joint]
    total = training_sums(arm.moments[joint].products) / SIGMA[joint] ** 2
    b = len(arm.base.columns)
    system = total[:, :-1, :-1].copy()
    right = total[:, :-1, -1].copy()
    system[:, :b, :b] += others.matrix
    right[:, :b] += others.vector
    gains = Information(system, right).solve()
    for one, used in zip(gains, training(arm), strict=True):
        shared, own = arm.stacked(used)
        close(one[:b], shared)
        if EXTRA[joint]:
            close(one[b:], own[joint])


@pytest.mark.parametrize("joint", range(JOINTS))
def test_a_joint_needs_only_the_columns_that_it_feels(arm, joint):
    """Fitted with those alone, not divided by its noise, it predicts held-out folds as all together."""
    felt = np.flatnonzero(arm.base.felt[joint])
    others = information_of_others(arm.moments, arm.prior)[joint].about(felt).times(SIGMA[joint] ** 2)
    columns = np.column_stack([arm.rows.regressor[:, joint][:, felt], arm.own[joint]])
    for f in range(FOLDS):
        used, s = arm.fold != f, len(felt)
        system, right = columns[used].T @ columns[used], columns[used].T @ arm.torque[used, joint]
        system[:s, :s] += others.matrix[1 + f]
        right[:s] += others.vector[1 + f]
        gains = Information(system, right).solve()
        shared, own = arm.stacked(used)
        held = ~used
        expected = arm.rows.regressor[held, joint] @ shared + arm.own[joint][held] @ own[joint]
        close(columns[held] @ gains, expected)


def test_moments_in_another_order_say_the_same(arm):
    joint, names = 4, list(arm.base.names)
    felt = [names[i] for i in np.flatnonzero(arm.base.felt[joint])]
    mixed = ["coulomb", *reversed(felt)]
    picked = {
        **{name: arm.rows.regressor[:, joint, i] for i, name in enumerate(names)},
        "coulomb": arm.own[joint][:, 0],
    }
    rows = np.column_stack([*(picked[name] for name in mixed), arm.torque[:, joint]])
    products = np.stack([rows[arm.fold == f].T @ rows[arm.fold == f] for f in range(FOLDS)])
    found = arranged(products, mixed, names, SIGMA[joint])
    np.testing.assert_allclose(found.products, arm.moments[joint].products, atol=1e-9)


def test_own_gains_beside_shared_ones_are_those_of_the_stacked_fit(arm):
    for joint in (0, 3, 6):
        shared = np.array([arm.stacked(used)[0] for used in training(arm)])
        expected = np.array([arm.stacked(used)[1][joint] for used in training(arm)])
        close(own_gains(arm.moments[joint], shared), expected)


def test_what_joints_share_beside_their_masses_needs_no_prior(arm):
    """A coupling of joints 5 and 6, in one fit of joint 5 with what the others know."""
    rng, coupled = np.random.default_rng(8), np.zeros((len(arm.fold), JOINTS, 1))
    coupled[:, 4, 0], coupled[:, 5, 0] = rng.normal(size=(2, len(arm.fold)))
    columns = np.concatenate([arm.rows.regressor, coupled], axis=2)
    torque = arm.torque + 0.5 * coupled[:, :, 0]
    moments = [
        joint_moments(columns[:, j], arm.own[j], torque[:, j], sigma=SIGMA[j], fold=arm.fold, folds=FOLDS)
        for j in range(JOINTS)
    ]
    both = information_of_others(moments, arm.prior.extended(1))[4] + shared_information(moments[4])
    assert both.solve()[:, -1] == pytest.approx(0.5, abs=0.01)


def test_dependent_own_columns_do_no_harm(arm):
    """Viscous friction twice says no more of the base parameters than once."""
    twice = joint_moments(
        arm.rows.regressor[:, 1],
        np.repeat(arm.own[1], 2, axis=1),
        arm.torque[:, 1],
        sigma=SIGMA[1],
        fold=arm.fold,
        folds=FOLDS,
    )
    one, two = (
        information_of_others([moments, arm.moments[2]], arm.prior)[1] for moments in (arm.moments[1], twice)
    )
    close(two.solve(), one.solve())
