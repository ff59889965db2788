"""A probing session made from formulas: a 3-link arm that presses a Kelvin-Voigt object at three speeds."""

import numpy as np

from palpate.control.loop.task import Phase

LINKS_M = (0.30, 0.28, 0.14)
SHOULDER_M = 0.30
SURFACE_M = 0.12
REACH_M = 0.45
STIFFNESS, DAMPING = 800.0, 30.0
FORCE_LIMIT_N = 10.0
PERIOD_S = 0.001


def tip_profile(speed_m_s, start_height_m=0.17):
    """Tip height over one run with the phase of each sample."""
    depth_end = FORCE_LIMIT_N / STIFFNESS
    approach = np.arange(start_height_m, SURFACE_M, -speed_m_s * PERIOD_S)
    t = np.arange(0, 0.25, PERIOD_S)
    loading = SURFACE_M - depth_end * (1 - np.exp(-t * speed_m_s / depth_end))
    parts = [
        (approach, Phase.APPROACH),
        (loading, Phase.LOADING),
        (np.full(400, loading[-1]), Phase.HOLD),
        (np.linspace(loading[-1], SURFACE_M, 250), Phase.UNLOADING),
        (np.linspace(SURFACE_M, start_height_m, 400), Phase.RETRACT),
    ]
    return np.concatenate([p for p, _ in parts]), np.concatenate([np.full(len(p), int(v)) for p, v in parts])


def joints_of(height_m):
    """Closed-form inverse kinematics with the last link pointing down."""
    l1, l2, l3 = LINKS_M
    x, z = np.full_like(height_m, REACH_M), height_m + l3 - SHOULDER_M
    q2 = np.arccos((x**2 + z**2 - l1**2 - l2**2) / (2 * l1 * l2))
    q1 = np.arctan2(-z, x) - np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))
    return np.column_stack([q1, q2, np.pi / 2 - q1 - q2])


def ticks(speeds_m_s=(0.15, 0.09, 0.06), seed=0):
    """Columns of the tick stream by name."""
    rng = np.random.default_rng(seed)
    heights, phases, runs = [], [], []
    for run, speed in enumerate(speeds_m_s):
        height, phase = tip_profile(speed)
        heights.append(height)
        phases.append(phase)
        runs.append(np.full(len(height), run))
    height, phase, run = np.concatenate(heights), np.concatenate(phases), np.concatenate(runs)
    n = len(height)
    time_s = np.arange(n) * PERIOD_S
    velocity = np.gradient(height, PERIOD_S)
    depth = np.maximum(SURFACE_M - height, 0)
    force = np.where(depth > 0, np.maximum(STIFFNESS * depth - DAMPING * velocity, 0), 0.0)
    q = joints_of(height)
    dq = np.gradient(q, PERIOD_S, axis=0)
    gravity = np.column_stack(
        [9.0 * np.cos(q[:, 0]), 3.2 * np.cos(q[:, 0] + q[:, 1]), 0.4 * np.cos(q.sum(axis=1))]
    )
    torque = -gravity + force[:, None] * np.array([0.42, 0.2, 0.02]) + 0.05 * dq
    in_contact = np.isin(phase, [Phase.LOADING, Phase.HOLD])
    tip = np.column_stack([np.full(n, REACH_M), np.zeros(n), height])
    zeros, nan = np.zeros(n), np.full(n, np.nan)
    settled = 1 - np.exp(-np.cumsum(depth > 0) / 150)
    learnt = np.cumsum(depth > 0) > 20
    return {
        "tick": np.arange(n),
        "time_s": time_s,
        "run": run,
        "phase": phase,
        "joint_position_rad": q,
        "joint_velocity_rad_s": dq,
        "torque_measured_nm": torque + rng.normal(0, 0.03, (n, 3)),
        "torque_commanded_nm": torque,
        "torque_sent_nm": torque,
        "force_n": force + rng.normal(0, 0.05, n),
        "reference_position_rad": q,
        "reference_velocity_rad_s": dq,
        "tip_position_world_m": tip,
        "tip_velocity_world_m_s": np.column_stack([zeros, zeros, velocity]),
        "press_direction_world": np.tile([0.0, 0.0, -1.0], (n, 1)),
        "desired_force_n": np.where(in_contact, FORCE_LIMIT_N, np.nan),
        "encoder_at_s": time_s,
        "torque_at_s": time_s,
        "force_at_s": time_s,
        "encoder_status": zeros.astype(int),
        "torque_status": zeros.astype(int),
        "force_status": zeros.astype(int),
        "guard_tripped": zeros.astype(bool),
        "stiffness_n_m": np.where(learnt, STIFFNESS * settled + rng.normal(0, 2, n), nan),
        "damping_n_s_m": np.where(learnt, DAMPING * settled + rng.normal(0, 0.3, n), nan),
        "surface_m": np.where(learnt, -SURFACE_M, nan),
        **dict.fromkeys(
            ("read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s", "lateness_s"), zeros + 2e-05
        ),
    }


def urdf():
    """The arm's URDF."""
    links = '<link name="base"/>'
    joints = ""
    parent, origin = "base", f"0 0 {SHOULDER_M}"
    for i, length in enumerate(LINKS_M, 1):
        shape = f'<geometry><cylinder radius="0.02" length="{length}"/></geometry>'
        placed = f'<origin xyz="{length / 2} 0 0" rpy="0 1.5708 0"/>'
        links += f'<link name="link_{i}"><visual>{placed}{shape}</visual></link>'
        joints += (
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{origin}"/><axis xyz="0 1 0"/>'
            '<limit lower="-3.2" upper="3.2" effort="50" velocity="10"/></joint>'
        )
        parent, origin = f"link_{i}", f"{length} 0 0"
    return f'<robot name="synthetic">{links}{joints}</robot>'
