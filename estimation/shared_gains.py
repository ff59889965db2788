"""Information on gains that joints of one arm share.

Parameters that the motion does not excite stay physically consistent and near the URDF. A fit of one joint
whose normal equations include the information of the other joints equals the joint fit of all of them, see
`palpate.estimation.arm.consistent_fit`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

from palpate.estimation.arm.consistent_fit import (
    arranged,
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
    of_arm = [
        number
        for number, (data, model) in enumerate(zip(channels, models, strict=True))
        if _body_of(model) is not None and reject_reason(data) is None
    ]
    effect = _body_of(models[of_arm[0]]) if of_arm else None
    if effect is None or effect.arm is None or effect.urdf is None:
        return list(channels)
    names = [f"{effect.name}.{name}" for name in effect.arm.names]
    alone = []
    for number in of_arm:  # without these two effects, friction or an offset biases the base parameters
        model, data = models[number], channels[number]
        present = {term.kind for term in model.effects}
        lacking = [term for term in (CoulombFriction(), Bias()) if term.kind not in present]
        model = reduce(Model.with_effect, lacking, model)
        alone.append(fit_model(data, model, {}, usable(data)))
    if len({fit.problem.blocked.folds for fit in alone}) > 1:
        return list(channels)
    joints = [
        arranged(
            fit.problem.normal_equations(fit.solution.columns, fit.solution.target).products,
            list(fit.solution.model.gains),
            names,
            _noise(fit),
        )
        for fit in alone
    ]
    by_joint = [shared_information(joint) for joint in joints]
    pull = consistent_information(effect.arm, effect.urdf, reduce(add, by_joint))
    information = information_of_others(joints, pull)
    prepared = list(channels)
    for number, fit, others_say in zip(of_arm, alone, information, strict=True):
        felt = [name for name in names if name in fit.solution.model.gains]
        kept = np.array([name in felt for name in names])
        shared = SharedGains(tuple(felt), others_say.about(kept).times(_noise(fit) ** 2))
        prepared[number] = replace(channels[number], shared=shared)
    return prepared


def _body_of(model: Model) -> RigidBodyFitted | None:
    return next((effect for effect in model.effects if isinstance(effect, RigidBodyFitted)), None)


def _noise(fitted: FitResult) -> float:
    """Return the root mean square residual of a joint's own fit on blocks."""
    return float(np.sqrt(np.mean(fitted.solution.residual[fitted.problem.used] ** 2)))
