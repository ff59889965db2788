"""Worlds with one hidden effect, moved by hand or by themselves."""

import numpy as np

from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.imperfection import IMPERFECTIONS, parse_imperfection
from palpate.sim_backend.scenario import load_scenario
from palpate.sim_backend.world import World
from tests.sim_backend.parts import GRAVITY_M_S2, slider

STEP_S = 0.25e-3
SPRING = KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=0.0)
QUIET = {
    "force": {"noise_std_n": 0.0, "resolution_n": 0.0, "range_n": 1e9},
    "torque": {"noise_std_nm": 0.0, "resolution_nm": 0.0},
    "encoder": {"counts_per_revolution": 1e11},
}
ALL = sorted(IMPERFECTIONS)


def hidden(effect, **parameters):
    return parse_imperfection({"effect": effect, **parameters})


def quiet_scenario(*entries, law=SPRING, gravity=GRAVITY_M_S2, surface_m=0.0, rate_hz=4000.0):
    """A world without noise, with these hidden effects."""
    settings = {
        "object": {"surface_height_m": surface_m, "law": law},
        "sensors": QUIET,
        "physics": {"gravity_m_s2": gravity, "rate_hz": rate_hz},
    }
    return load_scenario(settings).with_hidden(entries)


def hidden_slider(*entries, height_m=5.0, mass_kg=1.0, **options):
    """A mass on a vertical slider, far above the object if nothing else is said."""
    return World(slider(height_m, mass_kg), quiet_scenario(*entries, **options))


def press(entries, depth_m, rate_m_s=None, law=SPRING):
    """Force at each of the depths (n) [m] of a tip that is led by hand, a physics step apart."""
    depth_m = np.asarray(depth_m, dtype=float)
    rate_m_s = np.gradient(depth_m, STEP_S) if rate_m_s is None else np.broadcast_to(rate_m_s, depth_m.shape)
    world = hidden_slider(*entries, height_m=0.5, law=law)
    world.held = True
    force = []
    for depth, rate in zip(depth_m, rate_m_s, strict=True):
        world.place([-depth], [-rate])
        force.append(world.truth().force_n)
    world.close()
    return np.array(force)


def steps(duration_s):
    """Times from one step on [s]."""
    return STEP_S * np.arange(1, round(duration_s / STEP_S) + 1)


def let_go(world, duration_s, speed=0.0):
    """Positions and speeds (n) of the slider at each step from now on, starting with a speed."""
    world.place(world.truth().joint_position_rad, [speed])
    start_s, position, velocity = world.time_s, [], []
    for time_s in steps(duration_s):
        world.advance_to(start_s + time_s)
        truth = world.truth()
        position.append(truth.joint_position_rad[0])
        velocity.append(truth.joint_velocity_rad_s[0])
    return np.array(position), np.array(velocity)
