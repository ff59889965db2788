"""Compare all estimators with those of well-known libraries: error over Cramer-Rao bound, time per call.

    OMP_NUM_THREADS=1 python benchmarks/estimators.py [--draws 100] [--only robust,robust_hunt_crossley]

Error: root mean square over the bound, for k / c (Kelvin-Voigt) or k / b / n (Hunt-Crossley), with the same
noise for all. Time: median processor time of one call with 4000 samples, or per sample for recursive
estimators, including what follows, such as standard errors. The bound always refers to clean samples: without
30 % of the samples no estimator can come nearer to it than 1.2.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import statsmodels.api as sm
from harness import arguments, print_table
from presses import Noise, Press
from scipy.optimize import least_squares
from sklearn.linear_model import HuberRegressor, LinearRegression, RANSACRegressor, TheilSenRegressor

from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.estimator import ContactLaw, OnlineContactLaw, OnlineEstimator
from palpate.estimation.estimators import ESTIMATORS
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

KELVIN_VOIGT = Press(ContactLaw(500.0, 20.0))
HUNT_CROSSLEY = Press(ContactLaw(2000.0, 1500.0, 1.3, 1.3))
NOISES = {
    "even 0.02 N": Noise(),
    "2 % of force": Noise(0.005, 0.02),
    "10 % of force": Noise(0.005, 0.1),
    "30 % outliers": Noise(outliers=0.3),
    "2 %, 30 % outl.": Noise(0.005, 0.02, 0.3),
}
SLOW_DRAWS = 5  # for methods that take a tenth of a second

Method = Callable[[Press, FloatArray, int], FloatArray]


def linear(name: str, press: Press, force_n: FloatArray, seed: int) -> FloatArray:
    """Return one of palpate's linear estimators."""
    estimate = ESTIMATORS[name]().fit(press.regression(force_n), rng=np.random.default_rng(seed))
    return np.array([parameter.value for parameter in estimate.parameters])


def contact(name: str, press: Press, force_n: FloatArray, seed: int) -> FloatArray:
    """Return one of palpate's estimators of contact laws."""
    rng = np.random.default_rng(seed)
    law = CONTACT_ESTIMATORS[name]().fit(press.depth_m, press.speed_m_s, force_n, rng=rng)
    return np.array([law.stiffness, law.damping, law.exponent])[: len(press.truth)]


def scikit(make: Callable[[int], object], press: Press, force_n: FloatArray, seed: int) -> FloatArray:
    """Return a scikit-learn regressor on columns scaled to similar size."""
    columns = press.regression(force_n).columns
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    model = make(seed).fit(columns / sizes, force_n)
    return np.asarray(getattr(model, "estimator_", model).coef_) / sizes


def cauchy(press: Press, force_n: FloatArray, _seed: int) -> FloatArray:
    """Return scipy's least_squares with a Cauchy loss at the true noise; in logarithms for Hunt-Crossley."""
    columns = press.regression(force_n).columns
    depth, speed = columns.T
    if len(press.truth) == 2:
        sizes = np.sqrt(np.mean(columns**2, axis=0))
        start = np.linalg.lstsq(columns / sizes, force_n, rcond=None)[0]
        left = lambda q: columns / sizes @ q - force_n  # noqa: E731
        return np.asarray(least_squares(left, start, loss="cauchy", f_scale=0.05).x / sizes)
    power = lambda q: np.exp(q[0] + q[2] * np.log(depth / 0.006)) * (1 + q[1] * speed) - force_n  # noqa: E731
    log_k, ratio, n = least_squares(power, [np.log(2.0), 0.5, 1.5], loss="cauchy", f_scale=0.05).x
    k = np.exp(log_k) / 0.006**n
    return np.array([k, ratio * k, n])


def rlm(press: Press, force_n: FloatArray, _seed: int) -> FloatArray:
    """Return statsmodels' robust linear model with the biweight."""
    model = sm.RLM(force_n, press.regression(force_n).columns, M=sm.robust.norms.TukeyBiweight())
    return np.asarray(model.fit().params)


LINE, SLOW = LinearRegression(fit_intercept=False), "sklearn TheilSenRegressor"
SCIKIT = {  # of these, RANSAC gets a threshold of three times the noise
    "sklearn RANSACRegressor": lambda seed: RANSACRegressor(
        LINE, min_samples=5, residual_threshold=0.06, random_state=seed
    ),
    "sklearn HuberRegressor": lambda _: HuberRegressor(fit_intercept=False, alpha=0.0),
    SLOW: lambda seed: TheilSenRegressor(fit_intercept=False, random_state=seed, max_subpopulation=2000),
}
OTHERS: Mapping[str, Method] = {name: partial(scikit, make) for name, make in SCIKIT.items()}
OTHERS |= {"scipy cauchy": cauchy, "statsmodels RLM": rlm}


def errors(method: Method, press: Press, noise: Noise, draws: int) -> tuple[FloatArray, float]:
    """Return the root mean square error over the bound, and the median time of a call [s]."""
    off, times = [], []
    for seed in range(draws):
        force_n = press.read(noise, np.random.default_rng(seed))
        begun = time.process_time()
        try:
            off.append(method(press, force_n, seed) - press.truth)
        except InputError:
            continue
        times.append(time.process_time() - begun)
    if not off:
        return np.full(len(press.truth), np.nan), float("nan")
    return np.sqrt(np.mean(np.square(off), axis=0)) / press.bound(noise), float(np.median(times))


def table(title: str, press: Press, methods: Mapping[str, Method], draws: int) -> None:
    """Print one line for each method."""
    rows = []
    for name, method in methods.items():
        kind = {**ESTIMATORS, **CONTACT_ESTIMATORS}.get(name, object)
        online = issubclass(kind, OnlineEstimator | OnlineContactLaw)
        few = min(draws, SLOW_DRAWS) if online or name == SLOW else draws
        found = [errors(method, press, noise, few) for noise in NOISES.values()]
        seconds = float(np.nanmedian([taken_s for _, taken_s in found]))
        time_cell = f"{1e6 * seconds / press.count:.2f} us" if online else f"{1e3 * seconds:.2f} ms"
        rows.append((name, *(" / ".join(f"{value:.3g}" for value in over) for over, _ in found), time_cell))
    title += f", {press.count} samples, {draws} draws; error over the Cramer-Rao bound"
    print_table(title, ("", *NOISES, "time"), rows)


def main() -> None:
    """Print all tables."""
    parser = arguments(__doc__)
    parser.add_argument("--draws", type=int, default=100, help="of each noise")
    parser.add_argument("--only", help="these methods alone, with commas between them")
    chosen = parser.parse_args()
    only = chosen.only.split(",") if chosen.only else [*ESTIMATORS, *CONTACT_ESTIMATORS, *OTHERS]
    flat: Mapping[str, Method] = {name: partial(linear, name) for name in ESTIMATORS} | OTHERS
    laws = (name for name, each in CONTACT_ESTIMATORS.items() if each.model == "hunt_crossley")
    curved = {name: partial(contact, name) for name in laws} | {"scipy cauchy": cauchy}
    for title, press, methods in (
        ("Kelvin-Voigt", KELVIN_VOIGT, flat),
        ("Hunt-Crossley", HUNT_CROSSLEY, curved),
    ):
        table(title, press, {name: methods[name] for name in methods if name in only}, chosen.draws)


if __name__ == "__main__":
    main()
