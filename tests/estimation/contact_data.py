"""Contact channels made from formulas."""

import numpy as np

from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate_channel import estimate_channel
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.models import MODELS


def swing(count=2000, deepest_m=0.012):
    """Time, depth and speed of pressing in and out with rising frequency, always in contact."""
    t = np.arange(count) * 1e-3
    phase = 2 * np.pi * (1.5 * t + 2 * t**2)
    depth = 1e-4 + deepest_m / 2 * (1 - np.cos(phase))
    return t, depth, deepest_m / 2 * np.sin(phase) * 2 * np.pi * (1.5 + 4 * t)


def channel(force, position, velocity, time_s, *, kind=ChannelKind.CONTACT, run=None, acceleration=None):
    """A channel of one run unless `run` says more."""
    zeros = np.zeros(len(time_s))
    number = zeros.astype(np.int64) if run is None else run
    a = zeros if acceleration is None else acceleration
    name = "contact" if kind is ChannelKind.CONTACT else "joint_1"
    return ChannelData(name, kind, time_s, position, velocity, a, force, number, np.full(len(zeros), -1))


def base_model(name, **context):
    return MODELS[name]().build(ModelContext(**context))


def estimated(data, model="kelvin_voigt", by="lsq", **context):
    """A base model of a channel by an estimator."""
    return estimate_channel(
        data, base_model(model, **context), ESTIMATORS[by](), rng=np.random.default_rng(0)
    )
