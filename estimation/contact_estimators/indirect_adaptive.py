"""The adaptive law of force tracking by impedance control."""

from estimation.contact_estimator import ContactLaw, OnlineContactLaw
from robot_io.errors import InputError

_LIKELY = (1000.0, 100.0)  # N/m, N s/m: relative size of the gains' steps


class IndirectAdaptive(OnlineContactLaw):
    """F = k x + c v by the normalised gradient of the squared force error.

        e = F - k x - c v,     theta' = theta + rate G phi e / (noise + phi' G phi)

    with phi = (x, v) and G diagonal, x from where the surface was felt. The gradient needs no matrix and is
    stable by Lyapunov; it forgets within about 1 / rate samples, and what the motion does not
    excite stays where it was: add an excitation to the plan (A. Misra, A. M. Okamura, Environment Parameter
    Estimation during Bilateral Telemanipulation, Haptics Symposium 2006).

    Source: H. Seraji, R. Colbaugh, Force Tracking in Impedance Control, Int. J. Robotics Research 16 (1997).

    Args:
        rate: of the adaptation, in (0, 2).
        noise_n: force at which a step is halved [N].
    """

    name = "indirect_adaptive"
    model = "kelvin_voigt"

    def __init__(self, rate: float = 0.02, noise_n: float = 0.5) -> None:
        if not (0.0 < rate < 2.0 and noise_n >= 0.0):
            raise InputError(
                f"indirect_adaptive: rate {rate} must be within 0 and 2, noise {noise_n} positive"
            )
        self.rate, self.noise_n = rate, noise_n
        self.start()

    def start(self) -> None:
        self._k = self._c = 0.0

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        by_k, by_c = (likely**2 for likely in _LIKELY)
        size = by_k * depth_m**2 + by_c * speed_m_s**2 + self.noise_n**2
        error_n = force_n - self._k * depth_m - self._c * speed_m_s
        step = self.rate * error_n / size
        self._k += by_k * depth_m * step
        self._c += by_c * speed_m_s * step
        return ContactLaw(self._k, self._c)
