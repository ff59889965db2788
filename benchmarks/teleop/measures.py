"""What is measured of a coupling: force after convergence, energy, impedance by frequency."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from benchmarks.teleop.devices import HandArm, SoftSphere, SpringDamper, presses
from benchmarks.teleop.link import LinkFaults
from benchmarks.teleop.run import DT_S, START_M, Lines, Object, SimulatedLink, given_back_j, run
from control.teleop.couplings.catalogue import COUPLINGS
from control.teleop.couplings.channel import Packet
from control.teleop.couplings.coupling import Coupling
from control.teleop.couplings.model_mediated import ContactModel, model_mediated
from control.teleop.virtual_object import hunt_crossley

NAMES = tuple(coupling.name for coupling in COUPLINGS)
OBJECTS: dict[str, Object] = {
    "spring and damper": SpringDamper(1500.0, 10.0),
    "soft sphere": SoftSphere(22_600.0, 1.5, 1.5),
}
PRESSES_S = ((1.0, 2.5), (9.0, 21.0))  # a first touch, and one to feel with
DURATION_S = 20.0
LAST = slice(-1000, None)  # after convergence
STEADY_N = 0.5  # standard deviation of a force that has settled
MADE_J = 0.01  # more is given back by no passive one, nor by rounding
FREQUENCIES_HZ = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
AMPLITUDE_M = 1e-4
DEPTH_M = 0.005


@dataclass(frozen=True)
class Felt:
    """What an operator felt who pressed and waited."""

    felt_n: float  # mean of the last second
    spread_n: float  # standard deviation over it
    real_n: float  # of the real object at the depth of the operator's own tip
    follower_n: float  # on the follower's tool in that second
    free_air_n: float  # largest force before the virtual or the real object was touched
    given_back_j: float  # to the hand, above what it had put in
    balance_j: np.ndarray  # energy given to the hand less what it put in, at each step

    @property
    def verdict(self) -> str:
        """What is wrong with it, empty if it came to rest and made no energy."""
        if self.given_back_j > MADE_J:
            return "makes energy"
        return "not settled" if self.spread_n > STEADY_N else ""

    @property
    def error(self) -> float:
        """Relative error of the force felt."""
        return self.felt_n / self.real_n - 1.0 if self.real_n > 0.0 else float("nan")


def press(name: str, thing: str, faults: LinkFaults, seed: int = 0, link: Lines | None = None) -> Felt:
    """Press twice through the coupling of this name, and wait; over `link` if one is given."""
    target = OBJECTS[thing]
    hand = HandArm(presses(0.02, -START_M, PRESSES_S))
    trace = run(
        coupling_for(name, thing), target, hand, link or SimulatedLink(faults, seed), DURATION_S, seed
    )
    depth, rate = trace["hand_m"][LAST], trace["hand_m_s"][LAST]
    outside = trace["hand_m"][: np.argmax(trace["hand_m"] > 0.0)]
    balance = given_back_j(trace)
    return Felt(
        felt_n=trace["felt_n"][LAST].mean(),
        spread_n=trace["felt_n"][LAST].std(),
        real_n=float(np.mean([target.push_n(x, v) for x, v in zip(depth, rate, strict=True)])),
        follower_n=trace["object_n"][LAST].mean(),
        free_air_n=np.abs(trace["felt_n"][: len(outside)]).max(),
        given_back_j=max(0.0, balance.max()),
        balance_j=balance,
    )


def impedance_ratio(name: str, faults: LinkFaults, seed: int = 0) -> np.ndarray:
    """Impedance felt over the spring and damper's own, complex, at `FREQUENCIES_HZ`.

    The operator's tip is moved: it touches once, comes back, and then trembles inside at all frequencies.
    """
    plan = presses(DEPTH_M, -START_M, PRESSES_S)
    omega = 2.0 * np.pi * FREQUENCIES_HZ
    phase = np.arange(len(omega)) ** 2 * 1.3  # so that the peaks do not coincide

    def motion(time_s: float) -> tuple[float, float]:
        x, v = plan(time_s)
        if time_s < PRESSES_S[1][0] + 1.0:
            return x, v
        angle = omega * time_s + phase
        return x + AMPLITUDE_M * np.sin(angle).sum(), v + AMPLITUDE_M * (omega * np.cos(angle)).sum()

    thing = "spring and damper"
    trace = run(
        coupling_for(name, thing), OBJECTS[thing], motion, SimulatedLink(faults, seed), DURATION_S, seed
    )
    last = slice(-round(4.0 / DT_S), None)  # whole periods of all
    tones = np.exp(-1j * np.outer(omega, trace["time_s"][last]))
    felt = (tones @ trace["felt_n"][last]) / (tones @ trace["hand_m"][last])
    return felt / (1500.0 + 10.0j * omega)


def coupling_for(name: str, thing: str) -> Coupling:
    """The coupling of this name; the model-mediated one with a model that can describe the object."""
    if name == "model-mediated" and thing == "soft sphere":
        return model_mediated(HUNT_CROSSLEY)
    return COUPLINGS[NAMES.index(name)]


def _fit_hunt_crossley(samples: np.ndarray) -> Packet:
    """Stiffness [N/m^n], damping [N s/m^(n+1)], exponent and surface [m] by least squares."""
    position, velocity, force = samples.T

    def error_n(guess: np.ndarray) -> np.ndarray:
        log_k, loss, exponent, surface_mm = guess
        depth = np.maximum(position - 1e-3 * surface_mm, 1e-9)
        return np.exp(log_k) * depth**exponent * (1.0 + loss * velocity) - force

    log_k, loss, exponent, surface_mm = least_squares(
        error_n, [np.log(1e4), 0.5, 1.4, 1e3 * position.min()]
    ).x
    stiffness = float(np.exp(log_k))
    return stiffness, stiffness * float(loss), float(exponent), 1e-3 * float(surface_mm)


HUNT_CROSSLEY = ContactModel(
    fit=_fit_hunt_crossley,
    law=lambda parameters: (hunt_crossley(*parameters[:3]), parameters[3]),
    guess=(1e4, 1e4, 1.5, 0.0),
)
