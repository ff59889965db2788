"""The torques of all joints of an arm, and what they depend on, sample by sample or in means over samples."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from control.arm.rigid_body import RigidBody
from estimation.arm.base_parameters import BaseParameters
from estimation.signals.blocks import blocks
from robot_io.errors import InputError
from robot_io.types import FloatArray, IntArray

_AT_ONCE = 2000  # samples whose regressors are held before they are averaged


@dataclass(frozen=True)
class ArmRows:
    """The equations of all joints: torque_j = regressor_j @ base + shared_j @ gains + own_j @ own gains.

    Attributes:
        regressor: base-parameter columns of each joint's torque, shape (n, joints, b).
        shared: columns of what else belongs to the whole arm (a coupling of two joints), shape (n, joints,
            c).
        own: each joint's own columns (friction ...), one array (n, k_j) a joint.
        torque: shape (n, joints) [N m], what is known besides taken off.
        run: number of the run of each sample, shape (n,), samples of a run in order of time.
        weights: of each joint's squared residuals, shape (n, joints); 0 leaves a sample out, such as at
            rest where friction is anything up to its limit.
    """

    regressor: FloatArray
    shared: FloatArray
    own: tuple[FloatArray, ...]
    torque: FloatArray
    run: IntArray
    weights: FloatArray

    def __post_init__(self) -> None:
        """Check shapes.

        Raises:
            InputError: they do not belong together.
        """
        n, joints = self.torque.shape
        shapes = {
            "regressor": self.regressor.shape[:2],
            "shared": self.shared.shape[:2],
            "weights": self.weights.shape,
            "run": (len(self.run), joints),
            "own": (n, len(self.own)),
        }
        shapes |= {f"own[{j}]": (len(columns), joints) for j, columns in enumerate(self.own)}
        for what, shape in shapes.items():
            if shape != (n, joints):
                raise InputError(f"arm: {what} has {shape} samples and joints, torque has {(n, joints)}")

    def of_runs(self, runs: IntArray) -> "ArmRows":
        """Only the samples of these runs."""
        rows = np.isin(self.run, runs)
        own = tuple(columns[rows] for columns in self.own)
        kept = (self.torque[rows], self.run[rows], self.weights[rows])
        return ArmRows(self.regressor[rows], self.shared[rows], own, *kept)


def arm_rows(
    body: RigidBody,
    base: BaseParameters,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    torque: FloatArray,
    *,
    run: IntArray,
    own: Sequence[FloatArray],
    shared: FloatArray | None = None,
    weights: FloatArray | None = None,
    block: int = 1,
) -> ArmRows:
    """The equations along a motion.

    Means over blocks bend nothing, since columns and torque are averaged alike; they only lose what changes
    within a block, and with it most of what derivation makes of the encoders' steps.

    Args:
        body: the arm.
        base: its base parameters.
        motion: positions [rad], velocities and accelerations of all joints, each of shape (n, joints).
        torque: shape (n, joints) [N m].
        run: shape (n,), one stretch of samples for each run, in order of time.
        own: each joint's own columns, one array (n, k_j) a joint.
        shared: see `ArmRows`; None for no columns.
        weights: see `ArmRows`; None for 1. A block counts for a joint only if all its samples do.
        block: samples of one run whose mean is one row, up to twice as many.

    Raises:
        InputError: shapes do not belong together.
    """
    joints = body.joint_count
    shapes = {np.shape(part) for part in (*motion, torque)}
    if shapes != {(len(run), joints)}:
        raise InputError(f"arm: motion and torque have shapes {shapes}, expected {(len(run), joints)}")
    shared = np.zeros((len(run), joints, 0)) if shared is None else shared
    weights = np.ones((len(run), joints)) if weights is None else weights
    starts = _starts(run, block)

    def mean(values: FloatArray) -> FloatArray:
        return block_means(values, starts)

    whole = np.minimum.reduceat(weights, starts) > 0.0
    return ArmRows(
        np.concatenate(list(_regressor(body, base, motion, starts))),
        mean(shared),
        tuple(mean(columns) for columns in own),
        mean(torque),
        run[starts],
        np.where(whole, mean(weights), 0.0),
    )


def block_means(values: FloatArray, starts: IntArray) -> FloatArray:
    """Means over the samples (n, ...) from each start (m,) to the next, shape (m, ...)."""
    if values.size == 0:
        return np.zeros((len(starts), *values.shape[1:]))
    counts = np.diff(np.append(starts, len(values)))
    sums = np.add.reduceat(values, starts, axis=0)
    return np.asarray(sums / counts.reshape(-1, *[1] * (values.ndim - 1)))


def _starts(run: IntArray, block: int) -> IntArray:
    """First samples of blocks of equal size within each run."""
    parts = []
    for rows in blocks(run):
        count = max(1, (rows.stop - rows.start) // block)
        parts.append(rows.start + (np.arange(count) * (rows.stop - rows.start)) // count)
    return np.concatenate(parts)


def _regressor(
    body: RigidBody, base: BaseParameters, motion: tuple[FloatArray, ...], starts: IntArray
) -> Iterator[FloatArray]:
    """Block means of the base columns, some blocks at a time."""
    q, v, a = motion
    stops = np.append(starts[1:], len(q))
    chunks = np.array_split(np.arange(len(starts)), 1 + min(len(starts) - 1, len(q) // _AT_ONCE))
    for chunk in chunks:
        first, last = starts[chunk[0]], stops[chunk[-1]]
        rows = np.stack([body.regressor(q[i], v[i], a[i]) for i in range(first, last)])
        yield block_means(rows, starts[chunk] - first)[:, :, base.columns]
