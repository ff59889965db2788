"""Contract of every joint encoder."""

import numpy as np


def test_velocity_is_the_rate_of_the_position(active):
    """Over 50 ticks under a push, the integral of the velocity is the way that was gone."""
    push_nm = 0.05 * np.array(active.robot_file.limits.torque_nm)
    measurements = [active.tick(push_nm) for _ in range(50)]
    position = np.array([m.joint_position_rad for m in measurements])
    velocity = np.array([m.joint_velocity_rad_s for m in measurements])
    travelled = np.trapezoid(velocity, np.array([m.encoder_at_s for m in measurements]), axis=0)
    assert np.abs(position[-1] - position[0]).max() > 1e-3
    np.testing.assert_allclose(travelled, position[-1] - position[0], rtol=0.1, atol=2e-3)
