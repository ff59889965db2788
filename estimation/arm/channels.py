"""The joint channels of an arm as one set of equations, for models that fit its masses."""

from collections.abc import Mapping, Sequence

import numpy as np

from control.arm.rigid_body import RigidBody
from estimation.arm.base_parameters import BaseParameters
from estimation.arm.rows import ArmRows, arm_rows
from estimation.channel import ChannelData
from estimation.model import Model
from robot_io.errors import InputError
from robot_io.types import FloatArray

FITTED = "rigid_body_fitted"
_MOTION = ("joint_position", "joint_velocity", "joint_acceleration")


def rows_of_channels(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    inner: Sequence[Mapping[str, float]],
    body: RigidBody,
    base: BaseParameters,
    *,
    weights: FloatArray | None = None,
    block: int = 1,
) -> ArmRows:
    """The equations of all joints: masses shared, each model's other gains the joint's own.

    Args:
        channels: of all joints in the arm's order, sample by sample together.
        models: of each joint, with `rigid_body_fitted` and other effects that add torque.
        inner: nonlinear parameters of each model, by "effect.parameter".
        body: the arm.
        base: its base parameters.
        weights: see `ArmRows`.
        block: see `arm_rows`.

    Raises:
        InputError: channels are missing or of different samples, or a model does more than add torques.
    """
    _check(channels, models, body)
    parts = [
        model.without(FITTED).parts(channel, values)
        for channel, model, values in zip(channels, models, inner, strict=True)
    ]
    pressing = [channel.context.get("contact_torque", 0.0) for channel in channels]
    known = np.column_stack([part[1] + press for part, press in zip(parts, pressing, strict=True)])
    first = channels[0]
    q, v, a = (first.context[name].reshape(len(first), -1) for name in _MOTION)
    return arm_rows(
        body,
        base,
        (q, v, a),
        np.column_stack([channel.effort for channel in channels]) - known,
        run=first.run,
        own=[columns for columns, _ in parts],
        weights=weights,
        block=block,
    )


def _check(channels: Sequence[ChannelData], models: Sequence[Model], body: RigidBody) -> None:
    if len(channels) != body.joint_count:
        raise InputError(
            f"{FITTED}: {len(channels)} joint channels, but the arm has {body.joint_count} joints"
        )
    for channel, model in zip(channels, models, strict=True):
        if not np.array_equal(channel.run, channels[0].run):
            raise InputError(f"channel '{channel.name}': its samples are not those of '{channels[0].name}'")
        if [effect.name for effect in model.effects if effect not in model.additive]:
            raise InputError(
                f"channel '{channel.name}': only effects that add torque can be fitted for the whole arm"
            )
        if missing := [name for name in _MOTION if name not in channel.context]:
            raise InputError(f"channel '{channel.name}': {FITTED} needs {', '.join(missing)} of all joints")
