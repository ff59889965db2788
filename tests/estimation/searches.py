"""Searches with a few effects beside a swinging joint, or a pressed object."""

import numpy as np

from palpate.estimation.diagnosis.search import prepare_search
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.model import Model

SWING = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))
ROTOR = Model("inertia", (EFFECTS["inertia"](), EFFECTS["viscous_friction"]()))
PRESS = Model("kelvin_voigt", (EFFECTS["stiffness"](), EFFECTS["damping"]()))


def searched(data, *effects, base=SWING):
    """A search of a channel that knows these effects."""
    good = np.ones(len(data), dtype=np.bool_)
    return prepare_search(
        data, base, good, tuple(EFFECTS[name]() for name in effects), np.random.default_rng(0)
    )


def reached(search, *names):
    """The model that a search comes to with these effects, in this order."""
    end = search.start
    for name in names:
        (one,) = (one for one in search.screen(end) if one.effect.name == name)
        end = search.with_candidate(one)
    return end


def measured(search):
    """How the motion of a search's channel was read."""
    return identify_measurement_model(search.data)
