"""Estimators of a contact's stiffness and damping, each with its own contact law."""

import math

import numpy as np

from palpate.estimation.estimator import (
    ContactEstimator,
    ContactLaw,
    OnlineContactLaw,
    OnlineEstimator,
    check_samples,
)
from palpate.estimation.estimators.recursive import Ewrls, Sprls
from palpate.estimation.fit.irls import IrlsResult, irls
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_START_EXPONENT = 1.3
_EXPONENT_RANGE = (0.5, 4.0)


class DoubleStageRls(OnlineContactLaw):
    """Alternate between estimating the gains k and b at fixed exponent n, and n at fixed gains.

        F = k d^n + b d^n v,        ln(F / (k + b v)) = n ln d

    Convergence is slow and needs a start value near n: at similar depths, k and b compensate an error of n.

    Source: N. Diolaiti, C. Melchiorri, S. Stramigioli, Contact Impedance Estimation for Robotic Systems, IEEE
    Trans. Robotics 21 (2005).

    Args:
        forgetting: weight kept by each sample per step, in (0, 1], in both stages.
        exponent: start value of n.
    """

    name = "double_stage_rls"

    def __init__(self, forgetting: float = 0.995, exponent: float = _START_EXPONENT) -> None:
        low, high = _EXPONENT_RANGE
        if not low <= exponent <= high:
            raise InputError(f"double_stage_rls: exponent {exponent} must be between {low} and {high}")
        self._gains = Ewrls(forgetting)
        self._forgetting, self._first_exponent = forgetting, exponent
        self.start()

    def start(self) -> None:
        self._gains.start(2)
        self._exponent = self._first_exponent
        self._information = 1.0  # information on n: sum of squared logarithms of the depth

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        if depth_m <= 0.0:
            return None
        power = depth_m**self._exponent
        k, b = self._gains.update(np.array([power, power * speed_m_s]), force_n).tolist()
        k_eff = k + b * speed_m_s
        if force_n > MIN_FORCE_N and k_eff > 0.0:
            log_depth = math.log(depth_m)
            self._information = self._forgetting * self._information + log_depth**2
            error = math.log(force_n / k_eff) - self._exponent * log_depth
            updated = self._exponent + error * log_depth / self._information
            self._exponent = min(max(updated, _EXPONENT_RANGE[0]), _EXPONENT_RANGE[1])
        return ContactLaw(k, b, self._exponent, self._exponent)


_HYSTERESIS = 1.1


class HybridSprls(OnlineContactLaw):
    """Run two self-perturbing recursive least squares, and use the linear law if the object is stiff.

    Source: A. Pappalardo, A. Albakri, C. Liu, L. Bascetta, E. De Momi, P. Poignet, Hunt-Crossley Model Based
    Force Control for Minimally Invasive Robotic Surgery, Biomed. Signal Proc. Control 29 (2016).

    Args:
        switch_n_m: stiffness of the Kelvin-Voigt estimate above which this law is used [N/m].
        beta: see `Sprls`.
        gamma: see `Sprls`; per squared newton for Kelvin-Voigt, without unit for the logarithm of the force,
            which is perturbed only if the force changes by more than a factor of two.
    """

    name = "hybrid_sprls"

    def __init__(self, switch_n_m: float = 1000.0, beta: float = 20.0, gamma: float = 1.0) -> None:
        self._switch_n_m = switch_n_m
        self._linear = Sprls(beta, gamma)
        self._power = LogLinear(Sprls(beta, gamma))
        self.start()

    def start(self) -> None:
        self._linear.start(2)
        self._power.start()
        self._is_stiff = False

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        stiffness, damping = self._linear.update(np.array([depth_m, speed_m_s]), force_n).tolist()
        power = self._power.update(depth_m, speed_m_s, force_n)
        self._is_stiff = stiffness > (self._switch_n_m / _HYSTERESIS if self._is_stiff else self._switch_n_m)
        return ContactLaw(stiffness, damping) if self._is_stiff else power


_TYPICAL_GAINS = (1000.0, 100.0)  # k [N/m] and c [N s/m]; their squares scale the steps


class IndirectAdaptive(OnlineContactLaw):
    """Estimate F = k x + c v by the scaled gradient of the squared force error.

        e = F - k x - c v,     theta' = theta + rate G phi e / (noise^2 + phi' G phi)

    Here phi = (x, v), G is diagonal, and x is measured from the position of the first contact. The method
    needs no matrix, is Lyapunov stable, and forgets within about 1 / rate samples. Directions that the motion
    does not excite stay unchanged, so the plan should include an excitation (A. Misra, A. M. Okamura,
    Environment Parameter Estimation during Bilateral Telemanipulation, Haptics Symposium 2006).

    Source: H. Seraji, R. Colbaugh, Force Tracking in Impedance Control, Int. J. Robotics Research 16 (1997).

    Args:
        rate: adaptation rate, in (0, 2).
        noise_n: predicted force of typical gains at which the step is halved [N].
    """

    name = "indirect_adaptive"
    model = "kelvin_voigt"

    def __init__(self, rate: float = 0.02, noise_n: float = 0.5) -> None:
        if not (0.0 < rate < 2.0 and noise_n >= 0.0):
            raise InputError(
                f"indirect_adaptive: rate {rate} must be between 0 and 2, and noise {noise_n} at least 0"
            )
        self.rate, self.noise_n = rate, noise_n
        self.start()

    def start(self) -> None:
        self._k = self._c = 0.0

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        gain_k, gain_c = (typical**2 for typical in _TYPICAL_GAINS)
        norm = gain_k * depth_m**2 + gain_c * speed_m_s**2 + self.noise_n**2
        error_n = force_n - self._k * depth_m - self._c * speed_m_s
        step = self.rate * error_n / norm
        self._k += gain_k * depth_m * step
        self._c += gain_c * speed_m_s * step
        return ContactLaw(self._k, self._c)


MIN_FORCE_N = 0.05  # force below which the logarithm is mostly noise
_MAX_LOG = 50.0  # largest logarithm of a gain, to avoid overflow


class LogLinear(OnlineContactLaw):
    """Estimate ln F = ln k + n ln d + (b / k) v with any linear estimator.

    The law holds only if b v / k and the relative noise of the force are both far below 1. It approximates
    ln(1 + b v / k) by b v / k, and noise biases the mean of ln F.

    Args:
        linear: estimator of ln k, n and b / k.
    """

    def __init__(self, linear: OnlineEstimator) -> None:
        self._linear = linear
        self.start()

    def start(self) -> None:
        self._linear.start(3)

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        if depth_m <= 0.0 or force_n < MIN_FORCE_N:
            return None
        row = np.array([1.0, math.log(depth_m), speed_m_s])
        log_k, n, ratio = self._linear.update(row, math.log(force_n)).tolist()
        k = math.exp(min(log_k, _MAX_LOG))
        return ContactLaw(k, ratio * k, n, n)


class LogLinearEwrls(LogLinear):
    """`LogLinear` with exponentially weighted recursive least squares; `forgetting` as in `Ewrls`.

    Source: A. Haddadi, K. Hashtrudi-Zaad, Real-Time Identification of Hunt-Crossley Dynamic Models of Contact
    Environments, IEEE Trans. Robotics 28 (2012).
    """

    name = "log_linear_ewrls"

    def __init__(self, forgetting: float = 0.9995) -> None:
        super().__init__(Ewrls(forgetting))


_SCALE_M = 1e-4  # regularization: moves far below this length hardly change the estimate


class ModelReference(OnlineContactLaw):
    """Estimate the stiffness with a reference model of the force, driven by motion and current estimate.

        f_m' = f_m + pull (F - f_m) + k dx,     e = F - f_m,     k' = k + rate dx e / (dx^2 + scale^2)

    The error decays with the model's pole and adapts the stiffness (series-parallel identifier, Lyapunov
    stable). Only changes of position count, so neither the surface nor a constant force error matters, and
    the estimate stays constant at rest. Damping forces are attributed to the stiffness.

    Source: K. S. Narendra, A. M. Annaswamy, Stable Adaptive Systems (1989), ch. 3; for force control see
    `palpate.control.laws.force_laws`.

    Args:
        rate: adaptation rate, in (0, 1).
        pull: share of its error that the model corrects per sample, in (0, 1).
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
        last_depth_m, model_n = self._last
        move_m = depth_m - last_depth_m
        error_n = force_n - model_n - self._stiffness * move_m
        self._stiffness += self.rate * move_m * error_n / (move_m**2 + _SCALE_M**2)
        self._last = depth_m, force_n - (1.0 - self.pull) * error_n
        surface_m = depth_m - force_n / self._stiffness if self._stiffness > 0.0 else 0.0
        return ContactLaw(self._stiffness, 0.0, surface_m=surface_m)


_START_STD = (1e5, 1e5, 3e-4)  # initial standard deviations of k, b and the surface
_START_NOISE_N = 0.1
_NOISE_MEMORY = 0.99  # forgetting factor of the noise, per sample
_MIN_NOISE_N = 1e-4
_MIN_DEPTH_M = 1e-5


class ReducedKalman(OnlineContactLaw):
    """Estimate k, b and the surface s in F = (k + b v) (x - s)^n by a Kalman filter; the tool gives n.

    The reduction of the contact to one dimension gives n = 1 for a flat punch, 1.5 for a ball and 2 for a
    cone, so that only the material is unknown. The noise variance of the force is estimated from the squared
    innovations minus the part explained by the state's covariance. The covariance of k and b grows by a fixed
    share with each sample.

    Source: L. Beber et al., Towards Robotised Palpation for Cancer Detection through Online Tissue
    Viscoelastic Characterisation with a Collaborative Robotic Arm (2024), arXiv 2404.09542; noise: R. K.
    Mehra, Approaches to Adaptive Filtering, IEEE Trans. Automatic Control 17 (1972).

    Args:
        exponent: exponent n.
        drift: relative standard deviation of the change of k and b per sample.
    """

    name = "reduced_kalman"

    def __init__(self, exponent: float = 1.5, drift: float = 1e-5) -> None:
        if not exponent > 0.0 or drift < 0.0:
            raise InputError(
                f"reduced_kalman: exponent {exponent} must be positive, and drift {drift} at least 0"
            )
        self.exponent, self.drift = exponent, drift
        self.start()

    def start(self) -> None:
        self._state = np.zeros(3)
        self._covariance = np.diag(np.square(_START_STD))
        self._noise2 = _START_NOISE_N**2

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        k, b, surface_m = self._state.tolist()
        indentation_m = max(depth_m - surface_m, _MIN_DEPTH_M)
        power = indentation_m**self.exponent
        k_eff = k + b * speed_m_s
        row = np.array([power, power * speed_m_s, -k_eff * self.exponent * power / indentation_m])
        spread = self._covariance.dot(row)
        predicted_variance = float(row.dot(spread))
        error = force_n - k_eff * power
        gain = spread / (predicted_variance + self._noise2)
        self._state = self._state + gain * error
        self._covariance -= gain[:, None] * spread
        self._covariance[0, 0] += (self.drift * k) ** 2
        self._covariance[1, 1] += (self.drift * b) ** 2
        if predicted_variance < self._noise2:
            observed2 = max(error * error - predicted_variance, _MIN_NOISE_N**2)
            self._noise2 += (1.0 - _NOISE_MEMORY) * (observed2 - self._noise2)
        k, b, surface_m = self._state.tolist()
        return ContactLaw(k, b, self.exponent, self.exponent, surface_m)


_EXPONENTS = np.array([0.7, 0.85, 1.0, 1.15, 1.3, 1.45, 1.6, 1.8, 2.0, 2.25, 2.5, 3.0])
_PAIRS = 60  # random pairs; all contain outliers with probability 1e-12 at 40 % outliers
_RANKING_SAMPLES = 200
_MIN_SAMPLES = 10  # samples


class RobustHuntCrossley(ContactEstimator):
    """MM estimate of ln k, b / k and n jointly, with weights that follow the noise.

    The start is the least median of squares over pairs of samples, each solved for k and b at twelve
    exponents. A few biweight steps then lead to the efficient estimate, see `irls`. The estimator corresponds
    to `robust` for linear models; the surface must be known.

    Source: V. J. Yohai, High Breakdown-Point and High Efficiency Robust Estimates for Regression, Ann. Stat.
    15 (1987).
    """

    name = "robust_hunt_crossley"

    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        result, unit_m = self.settle(depth_m, speed_m_s, force_n, rng)
        log_push, ratio, n = result.values.tolist()
        k = float(np.exp(log_push)) / unit_m**n
        return ContactLaw(k, ratio * k, n, n)

    def settle(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, rng: np.random.Generator
    ) -> tuple[IrlsResult, float]:
        """Estimate ln(k u^n), b / k and n with their residuals, and return the unit of depth u [m], too.

        Args:
            depth_m: indentation of each sample, positive into the object, shape (n,) [m].
            speed_m_s: rate of indentation, shape (n,) [m/s].
            force_n: measured force, positive in compression, shape (n,) [N].
            rng: random generator for random subsets.

        Raises:
            InputError: too few samples are in contact, or no pair of them has a positive stiffness.
        """
        check_samples(self.name, depth_m, speed_m_s, force_n)
        touching = depth_m > 0.0
        if np.count_nonzero(touching) < _MIN_SAMPLES:
            raise InputError(
                f"{self.name}: only {np.count_nonzero(touching)} samples are in contact; at least "
                f"{_MIN_SAMPLES} are needed"
            )
        speed, force = speed_m_s[touching], force_n[touching]
        unit_m = float(np.median(depth_m[touching]))
        log_depth = np.log(depth_m[touching] / unit_m)

        def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            spring = np.exp(values[0] + values[2] * log_depth)
            predicted = spring * (1.0 + values[1] * speed)
            return predicted, np.column_stack([predicted, spring * speed, predicted * log_depth])

        # Choose ln k, b / k and n of the pair and exponent with the smallest median absolute residual.
        first, second = rng.integers(len(force), size=(2, _PAIRS))
        chosen = rng.permutation(len(force))[:_RANKING_SAMPLES]
        springs = np.exp(_EXPONENTS[:, None] * log_depth)
        # At a given exponent, F / d^n = k + b v is a line through two points.
        scaled = force / springs
        difference = speed[second] - speed[first]
        run_m_s = np.where(difference != 0.0, difference, np.inf)
        slopes = (scaled[:, second] - scaled[:, first]) / run_m_s
        levels = scaled[:, first] - slopes * speed[first]
        lines = levels[..., None] + slopes[..., None] * speed[chosen]
        distance = np.abs(force[chosen] - springs[:, None, chosen] * lines)
        middle = distance.shape[-1] // 2
        medians = np.partition(distance, middle, axis=-1)[..., middle]
        medians[levels <= 0.0] = np.inf
        if not np.isfinite(medians).any():
            raise InputError("robust_hunt_crossley: no pair of samples gives a positive stiffness")
        best = np.unravel_index(int(np.argmin(medians)), medians.shape)
        start = np.array([np.log(levels[best]), slopes[best] / levels[best], _EXPONENTS[best[0]]])
        return irls(evaluate, force, start), unit_m
