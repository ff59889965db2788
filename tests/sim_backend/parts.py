"""Small worlds for tests: a mass on a vertical slider, and the shipped arms, with or without sensor noise."""

from pathlib import Path

import numpy as np

from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.hooks import NO_EFFECTS
from palpate.sim_backend.scenario import load_scenario
from palpate.sim_backend.world import ArmDescription, World

ARMS_DIR = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
ARM_NAMES = ("follower", "leader")
GRAVITY_M_S2 = 9.81

SLIDER_URDF = """
<robot name="slider">
  <link name="rail"/>
  <link name="carriage">
    <inertial><mass value="{mass_kg}"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="lift" type="prismatic">
    <parent link="rail"/><child link="carriage"/><axis xyz="0 0 1"/>
    <limit lower="-10" upper="10" effort="1000" velocity="100"/>
  </joint>
  <link name="probe"/>
  <joint name="mount" type="fixed"><parent link="carriage"/><child link="probe"/></joint>
</robot>
"""


def slider(height_m=0.0, mass_kg=1.0):
    """A mass that moves along world z only; its joint position is the tip's height."""
    return ArmDescription(SLIDER_URDF.format(mass_kg=mass_kg), "probe", (0.0, 0.0, -1.0), (height_m,))


def shipped_arm(name):
    robot_file = load_robot_file(ARMS_DIR / name / f"{name}.yaml")
    urdf_text = robot_file.urdf_path.read_text(encoding="utf-8")
    return ArmDescription(urdf_text, "tip", robot_file.sensor_axis_tip, robot_file.home_rad)


def scenario(
    law=None,
    surface_m=0.0,
    rate_hz=4000.0,
    gravity=GRAVITY_M_S2,
    mass_scale=1.0,
    seed=1,
    engine=None,
    **sensors,
):
    """A scenario without a file; `force=..., torque=..., encoder=...` are the sensors' settings."""
    law = KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=20.0) if law is None else law
    return load_scenario(
        {
            "seed": seed,
            "object": {"surface_height_m": surface_m, "law": law},
            "arm": {"mass_scale": mass_scale},
            "sensors": sensors,
            "physics": {"rate_hz": rate_hz, "gravity_m_s2": gravity} | ({"engine": engine} if engine else {}),
        }
    )


def make_world(arm, settings=None, effects=NO_EFFECTS, start_s=0.0):
    return World(arm, scenario() if settings is None else settings, effects, start_s)


def inverse_dynamics(world, *motion):
    """Torques of a motion in free air, by the engine: positions, velocities and accelerations (n)."""
    return world._engine.inverse_dynamics(*(np.asarray(values, float).tolist() for values in motion))


def watch(world, duration_s, period_s=1e-3):
    """The truth at each period from now on, the present state included."""
    start_s = world.time_s
    truths = [world.truth()]
    for tick in range(1, round(duration_s / period_s) + 1):
        world.advance_to(start_s + tick * period_s)
        truths.append(world.truth())
    return truths


def column(truths, name):
    return np.array([getattr(truth, name) for truth in truths])


def sample_each_step(world, sensor, duration_s):
    """Every distinct sample that a reader at the physics rate gets, from now on."""
    step_s, start_s = 1.0 / world.scenario.physics.rate_hz, world.time_s
    samples = []
    for step in range(1, round(duration_s / step_s) + 1):
        world.advance_to(start_s + step * step_s)
        sample = sensor.read(world.time_s)
        if sample is not None and (not samples or sample.sampled_at_s != samples[-1].sampled_at_s):
            samples.append(sample)
    return samples
