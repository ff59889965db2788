"""Information on gains that joints of one arm share.

Parameters that the motion does not excite stay physically consistent and near the URDF. A fit of one joint
whose normal equations include the information of the other joints equals a fit of all joints together, see
`palpate.estimation.arm.consistent_fit`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

from palpate.estimation.arm.consistent_fit import (
    arrange_products,
    consistent_information,
    information_of_others,
    shared_information,
)
from palpate.estimation.channel import ChannelData, SharedGains
from palpate.estimation.data_quality import reject_reason, usable
from palpate.estimation.effects.friction import CoulombFriction
from palpate.estimation.effects.gravity_load import RigidBodyFitted
from palpate.estimation.effects.sensor_statics import Bias
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.model import Model


def with_shared_gains(channels: Sequence[ChannelData], models: Sequence[Model]) -> list[ChannelData]:
    """Add to each channel the information of the arm's other joints on the base parameters.

    Args:
        channels: channels of one robot.
        models: the base model of each channel.

    Returns:
        Channels in the order given. They are unchanged if any has shared information already, or if no joint
        with fitted base parameters passes the data checks.
    """
    if any(channel.shared is not None for channel in channels):
        return list(channels)
    arm_channels = [
        number
        for number, (data, model) in enumerate(zip(channels, models, strict=True))
        if _rigid_body(model) is not None and reject_reason(data) is None
    ]
    effect = _rigid_body(models[arm_channels[0]]) if arm_channels else None
    if effect is None or effect.arm is None or effect.urdf is None:
        return list(channels)
    names = [f"{effect.name}.{name}" for name in effect.arm.names]
    fits = []
    for number in arm_channels:  # without these two effects, friction or an offset biases the base parameters
        model, data = models[number], channels[number]
        present = {term.kind for term in model.effects}
        missing = [term for term in (CoulombFriction(), Bias()) if term.kind not in present]
        model = reduce(Model.with_effect, missing, model)
        fits.append(fit_model(data, model, {}, usable(data)))
    if len({fit.problem.blocked.folds for fit in fits}) > 1:
        return list(channels)
    joints = [
        arrange_products(
            fit.problem.normal_equations(fit.solution.columns, fit.solution.target).products,
            list(fit.solution.model.gains),
            names,
            _residual_rms(fit),
        )
        for fit in fits
    ]
    by_joint = [shared_information(joint) for joint in joints]
    prior = consistent_information(effect.arm, effect.urdf, reduce(add, by_joint))
    information = information_of_others(joints, prior)
    prepared = list(channels)
    for number, fit, others in zip(arm_channels, fits, information, strict=True):
        shared_names = [name for name in names if name in fit.solution.model.gains]
        is_shared = np.array([name in shared_names for name in names])
        shared = SharedGains(tuple(shared_names), others.about(is_shared).times(_residual_rms(fit) ** 2))
        prepared[number] = replace(channels[number], shared=shared)
    return prepared


def _rigid_body(model: Model) -> RigidBodyFitted | None:
    return next((effect for effect in model.effects if isinstance(effect, RigidBodyFitted)), None)


def _residual_rms(fitted: FitResult) -> float:
    """Return the root mean square residual of a joint's own fit on blocks."""
    return float(np.sqrt(np.mean(fitted.solution.residual[fitted.problem.used] ** 2)))
