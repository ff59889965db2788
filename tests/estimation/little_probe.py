"""A small independent probing simulator: a pushed mass that meets a spring and damper."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from palpate.control.loop.task import Phase
from palpate.control.loop.tick_record import tick_stream
from palpate.robot_io.session import Samples

MASS_KG = 1.5
STEP_S = 2e-4
TICK_S = 1e-3
FORCE_LIMIT_N = 10.0
NOISE_N = 0.02
FORCE_STEP_N = 0.005
COUNT_M = 2 * np.pi / 819200 * 0.7
CLEARANCE_M = 0.012


@dataclass
class Probe:
    """What one probing session recorded, a row a millisecond."""

    time_s: np.ndarray
    along_m: np.ndarray  # as the encoder has it
    force_n: np.ndarray  # as the sensor has it
    run: np.ndarray
    phase: np.ndarray
    true_along_m: np.ndarray
    true_speed_m_s: np.ndarray


def probe(law, *, surface_m=0.4321, speeds=(0.15, 0.09, 0.06), seed=0, noise_n=NOISE_N, hold_s=0.2):
    """Probe `law(depth, rate) -> N` at each speed: free air, approach, loading, hold, unloading, retract."""
    rng = np.random.default_rng(seed)
    rows, start_s = [], 0.0
    for number, speed in enumerate(speeds):
        run = _one_run(law, speed, hold_s)
        moved = run + np.array([start_s, surface_m, 0.0, 0.0, 0.0])
        rows.append(np.column_stack([moved, np.full(len(run), number)]))
        start_s = rows[-1][-1, 0] + 0.5
    time_s, along, velocity, force, phase, run = np.concatenate(rows).T
    sensed = np.round((force + noise_n * rng.standard_normal(len(force))) / FORCE_STEP_N) * FORCE_STEP_N
    counted = np.round(along / COUNT_M) * COUNT_M
    return Probe(time_s, counted, sensed, run.astype(int), phase.astype(int), along, velocity)


@cache
def _one_run(law, speed, hold_s):
    """The motion from the surface on without noise, the same for every seed; nobody may change the array."""
    depth, velocity, phase, since = -CLEARANCE_M, 0.0, Phase.FREE_AIR, 0.0
    rows = []
    for step in range(int(6.0 / STEP_S)):
        force = max(law(depth, velocity), 0.0) if depth > 0 else 0.0
        if step % round(TICK_S / STEP_S) == 0:
            rows.append((step * STEP_S, depth, velocity, force, phase))
            phase, since = _next_phase(phase, since + TICK_S, force, depth, velocity, hold_s)
            if phase is None:
                break
        push = force + MASS_KG * (_wanted_speed(phase, speed, force) - velocity) / 0.01
        velocity += STEP_S * (push - force) / MASS_KG
        depth += STEP_S * velocity
    return np.array(rows, dtype=float)


def _wanted_speed(phase, speed, force):
    if phase is Phase.FREE_AIR:
        return 0.0
    if phase in (Phase.UNLOADING, Phase.RETRACT):
        return -speed
    return min(max((FORCE_LIMIT_N - force) * 0.03, -speed), speed)


def _next_phase(phase, since, force, depth, velocity, hold_s):
    """The phase after this tick and the time since it began; None at the end."""
    ends = {
        Phase.FREE_AIR: (since > 0.15, Phase.APPROACH),
        Phase.APPROACH: (force > 0.3, Phase.LOADING),
        Phase.LOADING: (force > 0.95 * FORCE_LIMIT_N and abs(velocity) < 0.002, Phase.HOLD),
        Phase.HOLD: (since > hold_s, Phase.UNLOADING),
        Phase.UNLOADING: (depth < 0, Phase.RETRACT),
        Phase.RETRACT: (depth < -0.005, None),
    }
    over, following = ends[phase]
    return (following, 0.0) if over else (phase, since)


@cache
def kelvin_voigt(stiffness, damping):
    return lambda depth, rate: stiffness * depth + damping * rate


@cache
def hunt_crossley(k, b, n):
    return lambda depth, rate: depth**n * (k + b * rate)


def ticks(recorded, lateral_m=0.0, **changed):
    """The stream "tick" of a probe; the tip presses down, at `lateral_m` (one number or one each sample)."""
    count = len(recorded.time_s)
    stream = tick_stream(3)
    columns = {}
    for column in stream.columns:
        shape = (count,) if column.width == 1 else (count, column.width)
        columns[column.name] = np.zeros(shape, column.dtype)
    lateral = np.broadcast_to(lateral_m, (count,))
    columns |= {
        "tick": np.arange(count),
        "time_s": recorded.time_s,
        "encoder_at_s": recorded.time_s,
        "force_at_s": recorded.time_s,
        "torque_at_s": recorded.time_s,
        "run": recorded.run.astype(np.int32),
        "phase": recorded.phase.astype(np.int32),
        "force_n": recorded.force_n,
        "tip_position_world_m": np.column_stack([lateral, np.zeros(count), -recorded.along_m]),
        "press_direction_world": np.tile([0.0, 0.0, -1.0], (count, 1)),
        "joint_position_rad": np.outer(recorded.true_along_m, [1.0, -2.0, 0.5]),
        "torque_measured_nm": np.outer(recorded.force_n, [0.4, 0.2, 0.02]),
    }
    return Samples.from_records(stream, stream.records(columns | changed))
