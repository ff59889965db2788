"""The normal equations of all joints of an arm, and what each joint tells the others.

    tau_j(t) = S_j(t) beta + X_j(t) g_j + e_j(t),   e_j ~ (0, sigma_j^2)

beta is shared by all joints (base parameters, a payload, a tilt), g_j is the joint's own (friction ...).
Weighted least squares of all joints needs only the cross products of [S_j, X_j, tau_j]. With the own gains
of a joint profiled out (Schur complement), it says of beta, up to a constant,

    -log likelihood = beta' A_j beta / 2 - b_j' beta

so the joint least-squares solution is found by fitting one joint, with the sum of all other joints' A and b
added to its normal equations: exactly, and without iterating.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.information import Information
from robot_io.types import FloatArray


@dataclass(frozen=True)
class JointMoments:
    """Cross products of one joint's columns and torque, fold by fold."""

    # Shape (folds, s + k + 1, s + k + 1): first the s shared columns, in the same order for all joints (zero
    # where the joint does not feel them), then the joint's own k, last the torque.
    products: FloatArray
    shared: int  # s
    sigma: float  # standard deviation of the joint's noise in a sample [N m]


def arranged(products: FloatArray, names: Sequence[str], shared: Sequence[str], sigma: float) -> JointMoments:
    """Moments of one joint from cross products in another order.

    Args:
        products: shape (folds, q + 1, q + 1), the last of the torque.
        names: of the q columns.
        shared: names of the shared columns in their common order; those that are not among `names`, the
            joint does not feel. All other columns are the joint's own, in the order of `names`.
        sigma: standard deviation of the joint's noise.
    """
    own = [name for name in names if name not in set(shared)]
    place = {name: index for index, name in enumerate([*shared, *own])}
    there = np.array([*(place[name] for name in names), len(place)])
    whole = np.zeros((len(products), len(place) + 1, len(place) + 1))
    whole[:, there[:, None], there] = products
    return JointMoments(whole, len(shared), sigma)


def training_sums(products: FloatArray) -> FloatArray:
    """Sum products over all folds, and over all but each.

    Args:
        products: by fold, shape (folds, q, q).

    Returns:
        Shape (1 + folds, q, q).
    """
    whole = products.sum(axis=0, keepdims=True)
    return np.concatenate([whole, whole - products])


def shared_information(joint: JointMoments) -> Information:
    """What one joint says of the shared parameters, its own gains profiled out.

    Args:
        joint: normal equations of one joint.

    Returns:
        Matrix (1 + folds, s, s): from all folds, then from all but each.
    """
    total = training_sums(joint.products) / joint.sigma**2
    return Information(total[:, :-1, :-1], total[:, :-1, -1]).about(np.arange(joint.shared))


def information_of_others(joints: Sequence[JointMoments], prior: Information) -> tuple[Information, ...]:
    """For each joint, what all others and the prior say of the shared parameters.

    Args:
        joints: their moments, with the same folds.
        prior: of the shared parameters, matrix (s, s) or (1 + folds, s, s), such as that of
            `estimation.arm.prior`.

    Returns:
        One a joint, matrix (1 + folds, s, s) and vector (1 + folds, s): [0] from all folds, [1 + f] from
        all but fold f. To be added to the joint's own sums over the same folds, divided by its sigma^2; or
        `times` its sigma^2 to sums that are not. The fit of the one joint is then the fit of all of them.
    """
    each = [shared_information(joint) for joint in joints]
    return tuple(sum([*each[:j], *each[j + 1 :]], start=prior) for j in range(len(each)))
