"""Measure how well calibrations recover the errors hidden in the simulated follower, over seeds.

Each seed draws new hidden values. "error" gives the largest and the root mean square error, "stated" the mean
standard uncertainty, and "in 2 std" how many are within twice their own uncertainty (95 % are expected).
"""

import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from harness import arguments, print_table

from palpate.calibration.arm_fit import fit_arm, motion_of
from palpate.calibration.encoder import fit_encoder
from palpate.calibration.force import fit_force, read_weighing
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.session import Session
from palpate.runs import calibration as runs
from palpate.runs.calibration import CalibrationJob
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import load_scenario

ROBOT = find_robot("follower")
FORCES_N = (0.0, 5.0, 10.0, 20.0, 30.0, 40.0, 30.0, 20.0, 10.0, 5.0, 0.0)
BENDS = {"straight": 0.0, "bent 0.2 %": 5e-5, "bent 0.8 %": 2e-4, "bent 4 %": 1e-3}  # 1/N; % over 40 N
STOP_STD_RAD = 0.0  # the simulated stops are where the URDF says
Found = Iterator[tuple[str, str, float, float, float]]  # what, unit, found, stated uncertainty, hidden


def force(rng: np.random.Generator, seed: int, folder: Path) -> Found:
    """Calibrate gain, zero, curvature and hysteresis of force sensors; every second one has no hysteresis."""
    for shape, bend in BENDS.items():
        yield from _sensor(shape, rng.choice([-1, 1]) * bend, rng, seed, folder / shape.replace(" ", "-"))


def _sensor(shape: str, bend: float, rng: np.random.Generator, seed: int, folder: Path) -> Found:
    folder.mkdir()
    gain, bias = rng.uniform(0.9, 1.1), rng.uniform(-2.0, 2.0)
    play = rng.uniform(0.01, 0.05) if seed % 2 else 0.0
    hidden = [
        {"effect": "sensor_gain", "channel": "contact", "gain": gain, "bend": bend},
        {"effect": "bias", "channel": "contact", "bias": bias},
    ]
    hidden += [{"effect": "hysteresis", "channel": "contact", "half_width": play}] if play else []
    job = _job("force", hidden, seed, folder)
    runs.run_weighing(job, FORCES_N, runs.put_simulated_weight, settle_s=0.1, measure_s=0.5)
    fit = fit_force(read_weighing(Session.open(job.session)))
    yield f"force zero, {shape}", "N", fit.zero.value, fit.zero.std_err, bias
    yield f"force scale, {shape}", "-", fit.scale.value, fit.scale.std_err, 1.0 / gain
    yield f"hysteresis, {shape}", "N", fit.hysteresis_n.value, fit.hysteresis_n.std_err, 2.0 * play / gain


def encoder(rng: np.random.Generator, seed: int, folder: Path) -> Found:
    """Calibrate encoder zeros against the hard stops, with friction."""
    zeros = rng.uniform(-0.05, 0.05, 3)
    hidden = [_on(f"encoder_{j + 1}", zeros[j]) for j in range(3)]
    hidden += _joints("coulomb_friction", coulomb_nm=rng.uniform(0.02, 0.3, 3) * [1, 1, 0.1])
    job = _job("encoder", hidden, seed, folder)
    runs.run_stops(job)
    fit = fit_encoder(Session.open(job.session), 3, None, STOP_STD_RAD)
    for j in range(3):
        yield "encoder zero", "rad", fit.offset_rad[j], fit.std_rad[j], -zeros[j]


def arm(kind: str, rng: np.random.Generator, seed: int, folder: Path) -> Found:
    """Calibrate gains, offsets and friction of all drives on a tilted base; for `gravity`, only the tilt."""
    small = np.array([1.0, 1.0, 0.1])
    gain, bias = rng.uniform(0.85, 1.15, 3), rng.uniform(-0.2, 0.2, 3) * small
    coulomb, viscous = rng.uniform(0.05, 0.4, 3) * small, rng.uniform(0.05, 0.4, 3) * small
    pitch = rng.uniform(-0.05, 0.05)
    hidden = [
        {"effect": "gravity_tilt", "pitch_rad": pitch},
        *_joints("torque_gain", gain=gain),
        *_joints("coulomb_friction", coulomb_nm=coulomb),
        *_joints("viscous_friction", viscous_nms_rad=viscous),
        *(_on(f"joint_{j + 1}", bias[j]) for j in range(3)),
    ]
    job = _job(kind, hidden, seed, folder)
    runs.run_motion(job)
    body = RigidBody.from_urdf(ROBOT.urdf_path, ROBOT.tip_frame)
    fit = fit_arm(motion_of(Session.open(job.session).samples("tick")), body)
    way = "slow motion" if kind == "gravity" else "torque's motion"
    yield f"pitch, {way}", "rad", fit.tilt_rad.value[0], fit.tilt_rad.std_err[0], pitch
    for j in range(3 if kind == "torque" else 0):
        yield f"torque gain {j + 1}", "-", fit.gain.value[j], fit.gain.std_err[j], gain[j]
        yield "torque offset", "N m", fit.offset_nm.value[j], fit.offset_nm.std_err[j], -gain[j] * bias[j]
        yield "command offset", "N m", fit.command_offset_nm.value[j], fit.command_offset_nm.std_err[j], 0.0
        yield "Coulomb friction", "N m", fit.coulomb_nm.value[j], fit.coulomb_nm.std_err[j], coulomb[j]
        slope = fit.viscous_nms_rad
        yield "viscous friction", "N m s/rad", slope.value[j], slope.std_err[j], viscous[j]


def _job(kind: str, hidden: list[dict], seed: int, folder: Path) -> CalibrationJob:
    scenario = load_scenario({"seed": seed, "hidden": hidden})
    return CalibrationJob(ROBOT, folder / f"{kind}-{seed}.mcap", kind, scenario=scenario)


def _on(channel: str, bias: float) -> dict:
    return {"effect": "bias", "channel": channel, "bias": float(bias)}


def _joints(effect: str, **parameters: np.ndarray) -> list[dict]:
    return [
        {"effect": effect, "joint": j + 1, **{name: float(values[j]) for name, values in parameters.items()}}
        for j in range(3)
    ]


KINDS: dict[str, Callable[[np.random.Generator, int, Path], Found]] = {
    "force": force,
    "encoder": encoder,
    "torque": partial(arm, "torque"),
    "gravity": partial(arm, "gravity"),
}


def main() -> None:
    """Run the calibrations and print the results."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args()
    pairs: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    for kind in options.kinds:
        for seed in range(options.seeds):
            with tempfile.TemporaryDirectory() as folder:
                found = KINDS[kind](np.random.default_rng(seed), seed, Path(folder))
                for what, unit, value, stated, hidden in found:
                    pairs[what, unit].append((value - hidden, stated))
    rows = []
    for names, errors_and_stated in pairs.items():
        error, stated = np.abs(np.array(errors_and_stated)).T
        figures = (f"{value:.2g}" for value in (error.max(), np.sqrt(np.mean(error**2)), stated.mean()))
        rows.append((*names, len(error), *figures, f"{np.sum(error < 2 * stated)} of {len(error)}"))
    headers = ("what", "unit", "values", "error, largest", "rms", "stated", "in 2 std")
    print_table("What calibrations recover", headers, rows)


if __name__ == "__main__":
    main()
