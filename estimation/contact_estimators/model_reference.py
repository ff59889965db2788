"""A stiffness from a model that runs beside the contact."""

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from robot_io.errors import InputError

_SCALE_M = 1e-4  # move from sample to sample that counts as much as the rest of the normalisation


class ModelReference(OnlineContactLaw):
    """Pure stiffness: a reference model follows the force, driven by the motion and the present estimate.

        f_m' = f_m + pull (F - f_m) + k dx,     e = F - f_m,     k' = k + rate dx e / (dx^2 + scale^2)

    The error dies out with the model's pole and drives the stiffness (series-parallel identifier, stable by
    Lyapunov). It works on moves alone: no surface has to be known, a constant force error does not count, and
    while nothing moves nothing is learnt. What damping adds to the force passes for stiffness.

    Source: K. S. Narendra, A. M. Annaswamy, Stable Adaptive Systems (1989), ch. 3; for force control see
    `control.laws.force_laws`.

    Args:
        rate: of the adaptation, in (0, 1).
        pull: share of its error that the model makes up for per sample, in (0, 1).
    """

    name = "model_reference"
    model = "kelvin_voigt"

    def __init__(self, rate: float = 0.02, pull: float = 0.2) -> None:
        if not (0.0 < rate < 1.0 and 0.0 < pull < 1.0):
            raise InputError(f"model_reference: rate {rate} and pull {pull} must be between 0 and 1")
        self.rate, self.pull = rate, pull
        self.start()

    def start(self) -> None:
        self._stiffness = 0.0
        self._last: tuple[float, float] | None = None  # depth [m] and the model's force [N]

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        if self._last is None:
            self._last = depth_m, force_n
            return None
        before_m, model_n = self._last
        move_m = depth_m - before_m
        error_n = force_n - model_n - self._stiffness * move_m
        self._stiffness += self.rate * move_m * error_n / (move_m**2 + _SCALE_M**2)
        self._last = depth_m, force_n - (1.0 - self.pull) * error_n
        surface_m = depth_m - force_n / self._stiffness if self._stiffness > 0.0 else 0.0
        return ContactLaw(self._stiffness, 0.0, surface_m=surface_m)
