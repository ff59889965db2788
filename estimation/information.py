"""What measurements say of linear parameters: a quadratic that can be added to others."""

from dataclasses import dataclass

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_NO_DIRECTION = 1e-13  # of the largest eigenvalue: columns that depend on each other


@dataclass(frozen=True)
class Information:
    """A quadratic: beta' matrix beta / 2 - vector' beta, of one or of several fits."""

    matrix: FloatArray  # shape (..., s, s), symmetric
    vector: FloatArray  # shape (..., s)

    def __add__(self, other: "Information") -> "Information":
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def times(self, factor: float) -> "Information":
        """For normal equations that are not divided by the noise variance: times that variance."""
        return Information(factor * self.matrix, factor * self.vector)

    def about(self, chosen: IntArray | BoolArray) -> "Information":
        """Of these parameters alone, all others at their best beside them (Schur complement).

        Args:
            chosen: indices or mask of the parameters that are kept.
        """
        kept = np.zeros(self.vector.shape[-1], dtype=np.bool_)
        kept[chosen] = True
        cross = self.matrix[..., kept, :][..., ~kept] @ pseudo_inverse(self.matrix[..., ~kept, :][..., ~kept])
        matrix = self.matrix[..., kept, :][..., kept] - cross @ self.matrix[..., ~kept, :][..., kept]
        vector = self.vector[..., kept] - (cross @ self.vector[..., ~kept, None])[..., 0]
        return Information(0.5 * (matrix + np.swapaxes(matrix, -1, -2)), vector)


def pseudo_inverse(matrices: FloatArray) -> FloatArray:
    """Of symmetric matrices (..., k, k), whatever the columns' units."""
    scale = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    scale = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    scaled = matrices * scale[..., :, None] * scale[..., None, :]
    inverse = np.linalg.pinv(scaled, rcond=_NO_DIRECTION, hermitian=True)
    return np.asarray(inverse * scale[..., :, None] * scale[..., None, :])
