"""True parameters of hidden effects, by the names of the library."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from synthetic import joint

from estimation.channel import ChannelKind


@dataclass(frozen=True)
class Facts:
    """What a parameter may follow from: size and shape of the effect, the object, the noiseless effort."""

    kind: ChannelKind
    size: float
    shape: float
    k: float
    c: float
    scale: float
    largest: float
    last_s: float

    @property
    def depth(self) -> float:
        """Of the usual press [m]."""
        return 10.0 / self.k


def _hunt_crossley(f: Facts) -> dict[str, float]:
    n = 1.0 + f.size
    return {"n": n, "k": f.k * f.depth ** (1.0 - n), "b": 2.0 * f.c * f.depth**-n}


def _ripple(f: Facts) -> dict[str, float]:
    waves = 12.0 + np.floor(20.0 * f.shape)
    return {"sine": f.size * np.cos(1.0), "cosine": f.size * np.sin(1.0), "cycles": waves}


TRUTH: Mapping[str, Callable[[Facts], dict[str, float]]] = {
    "hunt_crossley": _hunt_crossley,
    "cubic_stiffness": lambda f: {
        "k3": f.size if f.kind is not ChannelKind.CONTACT else 10.0 * f.size / f.depth**3
    },
    "layered_stiffness": lambda f: {"k2": f.k * f.size, "depth": f.depth * (0.3 + 0.3 * f.shape)},
    "stress_relaxation": lambda f: {"k1": f.size * f.k, "tau": 0.08 * 10.0**f.shape},
    "quadratic_damping": lambda f: {"c2": 500.0 * f.size},
    "adhesion": lambda f: {"force": 10.0 * f.size, "reach": f.depth * (0.05 + 0.15 * f.shape)},
    "plastic_set": lambda f: {"share": min(f.size, 0.9)},
    "dry_friction": lambda f: {"force": 10.0 * f.size},
    "contact_offset": lambda f: {"offset": 0.2 * f.depth * f.size},
    "tool_compliance": lambda f: {"compliance": f.size / f.k},
    "coulomb_friction": lambda f: {"force": f.size},
    "stribeck_friction": lambda f: {"coulomb": 0.6 * f.size, "rise": f.size, "speed": 0.1 + 0.25 * f.shape},
    "asymmetric_friction": lambda f: {"forward": f.size, "backward": 0.45 * f.size},
    "load_dependent_friction": lambda f: {"mu": f.size},
    "quadratic_friction": lambda f: {"d2": f.size},
    "gravity_tilt": lambda f: {"tilt": f.size},
    "torque_ripple": _ripple,
    "joint_spring": lambda f: {"k": f.size},
    "backlash": lambda f: {"gap": 0.2 * f.size},
    "joint_elasticity": lambda f: {"compliance": f.size / 20.0},
    "bias": lambda f: {"offset": f.size * f.scale * (1.0 if f.shape > 0.5 else -1.0)},
    "drift": lambda f: {"rate": f.size * f.scale / f.last_s},
    "lag": lambda f: {"tau": 0.1 * f.size},
    "delay": lambda f: {"time": 0.1 * f.size},
    "saturation": lambda f: {"limit": f.largest * (1.0 - min(f.size, 0.95))},
    "deadband": lambda f: {"width": f.size * f.scale},
    "hysteresis": lambda f: {"width": f.size * f.scale},
    "quantisation": lambda f: {"step": f.size},
}
OF_THE_JOINT = {
    "pendulum.inertia": joint.INERTIA,
    "pendulum.gravity": joint.GRAVITY,
    "viscous_friction.d": joint.VISCOUS,
}


def of_effect(name: str, facts: Facts) -> dict[str, float]:
    """By "effect.parameter"; nothing where the world's law has no such number."""
    found = TRUTH.get(name, lambda _: {})(facts)
    return {f"{name}.{key}": float(value) for key, value in found.items()}
