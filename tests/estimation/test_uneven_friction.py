"""Friction that differs between the two directions pushes in neither of them at rest."""

import numpy as np
import pytest

from estimation.channel import ChannelData, ChannelKind
from estimation.effects import EFFECTS

INNER = {"transition": 0.01}


def columns(name, velocity):
    v = np.asarray(velocity, dtype=np.float64)
    still, count = np.zeros(len(v)), np.arange(len(v))
    data = ChannelData(
        "joint_1", ChannelKind.REVOLUTE, 0.001 * count, still, v, still, still, 0 * count, 0 * count
    )
    return EFFECTS[name]().columns(data, INNER)


def test_at_rest_it_is_nothing_where_a_bias_would_stay():
    assert not columns("asymmetric_friction", [0.0, 0.0]).any()


@pytest.mark.parametrize("velocity", [0.004, -0.004, 0.5, -0.5])
def test_each_direction_has_its_own_force(velocity):
    (row,) = columns("asymmetric_friction", [velocity])
    forward = velocity > 0.0
    assert (row[0] > 0.0, row[1] < 0.0) == (forward, not forward)
    assert (row[2] > 0.0, row[3] < 0.0) == (forward, not forward)


def test_alike_in_both_directions_it_is_coulomb_friction():
    speeds = [-0.3, -0.002, 0.0, 0.003, 0.2]
    uneven, even = columns("asymmetric_friction", speeds), columns("coulomb_friction", speeds)
    np.testing.assert_allclose(uneven[:, 0] + uneven[:, 1], even[:, 0])
