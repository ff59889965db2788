"""Hide a joint effect in a MuJoCo model, find it, export it to the nominal MJCF, and replay it there.

Each case hides one effect in a two-joint arm by MuJoCo's own means, records motions of it, lets palpate
diagnose four of them, writes what was found into the nominal MJCF, and predicts the torques of a fifth motion
by MuJoCo's inverse dynamics. This error should equal the held-out error of the fit. Then the nominal and
the patched arm move under the commands of the fifth motion (desired positions and velocities, for the same
feedback), and their positions are compared with those recorded. palpate's simulator is not used.

    python benchmarks/simulator_round_trip.py            # all ten cases, each with a diagnosis
    python benchmarks/simulator_round_trip.py payload    # one of them
"""

import tempfile
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from palpate import Study
from palpate.robot_io.types import FloatArray

STEP_S = 1e-3
EVERY = 2  # simulation steps per recorded sample
SECONDS = 6.0
NOISE_NM = 0.02
RUNS = 5  # the last is only replayed
JOINTS = ("shoulder", "elbow")
# MuJoCo's friction changes sign 1/100 s ahead of the motion by default; that of a joint does so at rest.
AT_REST = (2.0 * STEP_S, 1.0)

URDF = Path(__file__).with_name("two_links.urdf").read_text("utf-8")


@dataclass(frozen=True)
class ExportCase:
    """One hidden effect."""

    hide: Callable[[mujoco.MjSpec], None]
    channel: str
    effects: tuple[str, ...]  # effects in it


def _on_joint(joint: int, effects: str, **values: object) -> ExportCase:
    def hide(spec: mujoco.MjSpec) -> None:
        for key, value in values.items():
            setattr(spec.joint(JOINTS[joint - 1]), key, value)

    return ExportCase(hide, f"joint_{joint}", tuple(effects.split()))


def _tilt(spec: mujoco.MjSpec) -> None:
    spec.option.gravity = [9.81 * np.sin(0.12), 0.0, -9.81 * np.cos(0.12)]


def _payload(spec: mujoco.MjSpec) -> None:
    load = spec.body("fore").add_body(pos=[0.25, 0.0, 0.02])
    load.mass, load.ipos, load.inertia, load.explicitinertial = 0.4, [0.0] * 3, [1e-8] * 3, True


def _gain(spec: mujoco.MjSpec) -> None:
    next(each for each in spec.actuators if each.target == "shoulder").gear[0] = 0.8


_DRY = {"solref_friction": AT_REST}
CASES: Mapping[str, ExportCase] = {
    "coulomb": _on_joint(1, "coulomb_friction", frictionloss=0.5, **_DRY),
    "viscous": _on_joint(2, "viscous_friction", damping=[0.3, 0, 0]),
    "coulomb_and_viscous": _on_joint(
        1, "coulomb_friction viscous_friction", frictionloss=0.4, damping=[0.25, 0, 0], **_DRY
    ),
    "quadratic_friction": _on_joint(1, "quadratic_friction", damping=[0, 0.08, 0]),
    "armature": _on_joint(2, "armature", armature=0.02),
    "spring": _on_joint(2, "joint_spring", stiffness=[1.5, 0, 0], springref=0.4),
    "hardening_spring": _on_joint(2, "cubic_stiffness", stiffness=[0, 0, 2.0]),
    "gravity_tilt": ExportCase(_tilt, "joint_1", ("gravity_tilt",)),
    "payload": ExportCase(_payload, "joint_1", ("payload",)),
    "torque_gain": ExportCase(_gain, "joint_1", ("torque_gain",)),
}


@dataclass(frozen=True)
class RoundTrip:
    """Result of one case; errors are root mean squares over both joints [N m], those of motion [rad]."""

    found: Mapping[str, Sequence[str]]  # effects that the exported models have, by channel
    nominal: float  # of the nominal MJCF on the last run
    promised: float  # held-out error of the fit
    replayed: float  # of the patched MJCF on the last run
    nominal_motion: float  # of the nominal MJCF under the commands of the last run
    motion: float  # of the patched MJCF under the commands of the last run


def nominal_spec() -> mujoco.MjSpec:
    """Return the arm as MuJoCo reads its URDF, with a motor at each joint."""
    spec = mujoco.MjSpec.from_string(URDF)
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.degree, spec.compiler.fusestatic = False, False
    for name in JOINTS:
        motor = spec.add_actuator(name=f"{name}_motor", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    return spec


def record(model: mujoco.MjModel, seed: int) -> FloatArray:
    """Follow three sines per joint by feedback.

    The commands (desired positions and velocities) depend only on the seed, so that two arms can get the
    same.

    Args:
        model: the arm.
        seed: of motion and noise.

    Returns:
        Shape (n, 9): time [s], positions [rad], velocities [rad/s], commanded torques [N m] with noise, and
        accelerations [rad/s^2], which only `replay` sees.
    """
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    size = np.array([[0.5], [0.6]]) * [1.0, 0.5, 0.25]
    rate = rng.uniform([1.0, 2.5, 5.0], [2.0, 4.5, 9.0], (2, 3))
    phase = rng.uniform(0.0, 6.3, (2, 3))
    rows = []
    for step in range(int(SECONDS / STEP_S)):
        waves = rate * data.time + phase
        desired, speed = (size * np.sin(waves)).sum(1), (size * rate * np.cos(waves)).sum(1)
        if step == 0:
            data.qpos[:], data.qvel[:] = desired, speed
        data.ctrl[:] = [40.0, 20.0] * (desired - data.qpos) + [4.0, 1.5] * (speed - data.qvel)
        now = [data.time, *data.qpos, *data.qvel, *data.ctrl]
        mujoco.mj_step(model, data)
        if step % EVERY == 0:
            rows.append([*now, *data.qacc])
    table = np.array(rows)
    table[:, 5:7] += rng.normal(0.0, NOISE_NM, (len(table), 2))
    return table


def replay(model: mujoco.MjModel, run: FloatArray) -> FloatArray:
    """Return recorded minus expected controls by MuJoCo's inverse dynamics, shape (n, 2) [N m].

    Args:
        model: the arm, whose motors are its actuators.
        run: from `record`.
    """
    data, errors = mujoco.MjData(model), []
    for row in run:
        data.qpos[:], data.qvel[:], data.qacc[:] = row[1:3], row[3:5], row[7:]
        mujoco.mj_inverse(model, data)
        errors.append(row[5:7] - data.qfrc_inverse / model.actuator_gear[:, 0])
    return np.array(errors)


def round_trip(case: ExportCase, folder: Path, *, diagnose: bool) -> RoundTrip:
    """Hide, record, fit, export and replay.

    Args:
        case: the hidden effect.
        folder: for files.
        diagnose: whether palpate finds the effects; otherwise those of the case are added.
    """
    hidden = nominal_spec()
    case.hide(hidden)
    model = hidden.compile()
    runs = [record(model, seed) for seed in range(RUNS)]
    (folder / "arm.urdf").write_text(URDF)
    nominal = nominal_spec()
    plain = nominal.compile()
    (folder / "arm.xml").write_text(nominal.to_xml())
    path = _write_csv(folder / "arm.csv", runs[:-1])
    study = Study(path, arm=folder / "arm.urdf", folder=folder / "study")
    found: dict[str, list[str]] = {case.channel: list(case.effects)}
    if diagnose:
        channels = study.diagnose().channels
        found = {
            each.channel: [entry.effect for entry in each.accepted] for each in channels if each.accepted
        }
    for name, effects in found.items():
        study.add(*effects, channel=name)
    study.export_simulator(folder / "better.xml", "mjcf", folder / "arm.xml")
    fits = [study.fit(each, found.get(each.name, [])) for each in study.channels]
    better = mujoco.MjModel.from_xml_path(str(folder / "better.xml"))
    rms = [float(np.sqrt(np.mean(replay(each, runs[-1]) ** 2))) for each in (plain, better)]
    promised = float(np.sqrt(np.mean([fit.rmse**2 for fit in fits])))
    moved = [record(each, RUNS - 1)[:, 1:3] - runs[-1][:, 1:3] for each in (plain, better)]
    motion = [float(np.sqrt(np.mean(error**2))) for error in moved]
    return RoundTrip(found, rms[0], promised, rms[1], *motion)


def _write_csv(path: Path, runs: Sequence[FloatArray]) -> Path:
    columns = ("position_{}_rad", "velocity_{}_rad_s", "torque_{}_Nm")
    names = ",".join(["run", "time_s", *(name.format(joint) for name in columns for joint in (1, 2))])
    rows = np.concatenate([np.column_stack([np.full(len(run), i), run[:, :7]]) for i, run in enumerate(runs)])
    np.savetxt(path, rows, delimiter=",", header=names, comments="", fmt="%.9g")
    return path


def main() -> None:
    """Print the table."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; default: all")
    for name in parser.parse_args().cases or CASES:
        with tempfile.TemporaryDirectory() as folder:
            trip = round_trip(CASES[name], Path(folder), diagnose=True)
        found = "; ".join(f"{key} {', '.join(value)}" for key, value in trip.found.items()) or "nothing"
        errors = f"{trip.nominal:7.4f} -> promised {trip.promised:7.4f}, replayed {trip.replayed:7.4f} N m"
        verdict = "kept" if trip.replayed <= 1.05 * trip.promised else "BROKEN"
        motion = f"motion {trip.nominal_motion:.2e} -> {trip.motion:.2e} rad"
        print(f"{name:20} {errors} {verdict}; {motion}  ({found})", flush=True)


if __name__ == "__main__":
    main()
