"""Calibration procedures on the simulated arm, through loop, guard and session file."""

import shutil
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from palpate.calibration.arm_fit import fit_arm, motion_of
from palpate.calibration.arm_motion import ExcitationSettings
from palpate.calibration.encoder import StopSettings, fit_encoder
from palpate.calibration.force import fit_force, read_weighing
from palpate.common.files import write_text
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.study.estimates import estimate_with
from palpate.estimation.study.sessions import arm_of
from palpate.estimation.study.source import open_source
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.robot_file import load_robot_file, parse_robot_file
from palpate.robot_io.session import Session
from palpate.runs import calibration as runs
from palpate.runs import calibration_file as fits
from palpate.runs.calibration_file import open_recorded
from palpate.runs.probing import ProbingJob, run_probing
from palpate.sim_backend.scenario import load_scenario
from tests.calibration.simulated import FOLLOWER, in_joints, job_in, made, opened
from tests.robot_io.calibration.parts import parse_calibration

pytestmark = pytest.mark.slow

FORCES_N = [0.0, 10.0, 20.0, 40.0, 20.0, 10.0, 0.0]
SHORT = ExcitationSettings(duration_s=12.0, period_s=6.0)
BIAS, GAIN = "bias", "sensor_gain"


def weighed(folder, hidden, seed, robot=FOLLOWER):
    job = job_in(folder, "force", hidden, seed, robot)
    runs.run_weighing(job, FORCES_N, runs.put_simulated_weight, settle_s=0.02, measure_s=0.1)
    return job, fit_force(read_weighing(opened(job)))


def test_force_sensor_is_calibrated_within_its_uncertainty(tmp_path):
    """Six sensors: at most two of 12 values outside of two standard uncertainties (binomial, 1.7 %)."""
    outside = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        gain, bias = rng.uniform(0.9, 1.1), rng.uniform(-2.0, 2.0)
        hidden = [
            {"effect": GAIN, "channel": "contact", "gain": gain},
            {"effect": BIAS, "channel": "contact", "bias": bias},
        ]
        _, fit = weighed(tmp_path, hidden, seed)
        outside += abs(fit.zero.value - bias) > 2 * fit.zero.std_err
        outside += abs(fit.scale.value - 1 / gain) > 2 * fit.scale.std_err
        assert fit.scale.std_err < 1e-3
    assert outside <= 2


def test_weights_beyond_the_limit_are_refused_before_opening(tmp_path):
    job = job_in(tmp_path, "force", [])
    with pytest.raises(InputError, match=r"61 N: must be below limits\.force_n of 'follower', which is 60 N"):
        runs.run_weighing(job, [0.0, 10.0, 61.0, 20.0, 10.0, 0.0], runs.put_simulated_weight)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def excited(tmp_path_factory):
    """Drives with everything wrong on a tilted base, and the fit of a short motion."""
    hidden = {
        "gain": np.array([0.9, 1.1, 1.15]),
        "coulomb": np.array([0.3, 0.2, 0.02]),
        "viscous": np.array([0.2, 0.1, 0.01]),
        "bias": np.array([0.1, -0.1, 0.02]),
        "pitch": -0.02,
    }
    effects = [
        {"effect": "gravity_tilt", "pitch_rad": hidden["pitch"]},
        *in_joints("torque_gain", gain=hidden["gain"]),
        *in_joints("coulomb_friction", coulomb_nm=hidden["coulomb"]),
        *in_joints("viscous_friction", viscous_nms_rad=hidden["viscous"]),
        *({"effect": BIAS, "channel": f"joint_{j + 1}", "bias": float(hidden["bias"][j])} for j in range(3)),
    ]
    job = job_in(tmp_path_factory.mktemp("excited"), "torque", effects)
    runs.run_motion(job, SHORT)
    body = RigidBody.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame)
    return job, hidden, fit_arm(motion_of(opened(job).samples("tick")), body)


class TestDrives:
    def test_parameters_are_estimated_within_their_uncertainty(self, excited):
        _, hidden, fit = excited
        for found, std, true in (
            (fit.gain.value, fit.gain.std_err, hidden["gain"]),
            (fit.offset_nm.value, fit.offset_nm.std_err, -hidden["gain"] * hidden["bias"]),
            (fit.command_offset_nm.value, fit.command_offset_nm.std_err, np.zeros(3)),
            (fit.coulomb_nm.value, fit.coulomb_nm.std_err, hidden["coulomb"]),
            (fit.viscous_nms_rad.value, fit.viscous_nms_rad.std_err, hidden["viscous"]),
        ):
            assert np.all(np.abs(found - true) < 4 * std)
        assert np.all(fit.gain.std_err < 2e-3)

    def test_base_tilt_is_estimated_within_its_uncertainty(self, excited):
        job, hidden, fit = excited
        calibration = fits.make_calibration("gravity", fit, FOLLOWER, job.session, 365.0)
        pitch = calibration.values.pitch
        assert abs(pitch.value - hidden["pitch"]) < 4 * pitch.std_err < 2e-3
        assert calibration.values.roll is None  # the joints' axes are all across

    def test_calibration_file_states_its_origin_and_the_arm_returns_home(self, excited):
        job, _, fit = excited
        calibration = made(job, fit)
        again = parse_calibration(calibration.to_yaml(), "torque.yaml")
        assert again == calibration
        assert again.raw_data.file == job.session.name
        assert again.device["driver"] == "sim_torque"
        assert "coulomb_friction" in again.findings
        session = opened(excited[0])
        ticks = session.samples("tick")
        assert not session.truncated
        assert not ticks["guard_tripped"].any()
        np.testing.assert_allclose(ticks["joint_position_rad"][-1], FOLLOWER.home_rad, atol=0.02)


ZEROS_RAD = (0.03, -0.02, 0.05)
WRONG_ZEROS = [
    {"effect": BIAS, "channel": f"encoder_{joint}", "bias": zero} for joint, zero in enumerate(ZEROS_RAD, 1)
]


def test_zeros_are_estimated_at_the_hard_stops_under_tight_limits(tmp_path, monkeypatch):
    low = {"velocity_rad_s": (1.1, 1.1, 1.1), "tracking_rad": (0.025, 0.025, 0.025)}
    limits = FOLLOWER.limits.model_copy(update=low)
    careful = FOLLOWER.model_copy(update={"limits": limits, "control_rate_hz": 500.0})
    quick = replace(StopSettings.within(careful.limits), speed_rad_s=0.1, touches=2)
    monkeypatch.setattr(StopSettings, "within", lambda _limits: quick)
    wrong = [
        *WRONG_ZEROS,
        *in_joints("coulomb_friction", coulomb_nm=(0.3, 0.2, 0.03)),
        *in_joints("torque_gain", gain=(0.85, 1.15, 0.85)),
    ]
    scenario = load_scenario({"seed": 1, "hidden": wrong, "physics": {"rate_hz": 1000.0}})  # for 76 s
    job = replace(job_in(tmp_path, "encoder", wrong, robot=careful), scenario=scenario)
    runs.run_stops(job)
    fit = fit_encoder(opened(job), 3, None, 1e-4)
    np.testing.assert_allclose(fit.offset_rad, -np.array(ZEROS_RAD), atol=2e-4)
    ticks = opened(job).samples("tick")
    assert np.abs(ticks["torque_sent_nm"]).max() < 0.5 * max(FOLLOWER.limits.torque_nm)


def test_hard_stop_at_another_angle_stops_the_arm(tmp_path):
    job = job_in(tmp_path, "encoder", [])
    wrong = (np.full(3, np.nan), np.full(3, 2.0))
    with pytest.raises(PalpateError, match=r"joint 1 reached no stop at 2\.15\d rad, .*--upper-stops"):
        runs.run_stops(job, wrong)
    assert opened(job).samples("tick")["guard_tripped"][-1]


def test_zeros_are_estimated_in_a_known_pose_without_power(tmp_path):
    job = job_in(tmp_path, "encoder", WRONG_ZEROS)
    runs.run_pose(job)
    fit = fit_encoder(opened(job), 3, FOLLOWER.home_rad, 1e-3)
    np.testing.assert_allclose(fit.offset_rad, -np.array(ZEROS_RAD), atol=1e-4)
    np.testing.assert_allclose(fit.std_rad, 1e-3, rtol=0.1)
    assert not opened(job).samples("tick")["torque_sent_nm"].any()
    other = FOLLOWER.text.replace("driver: sim_encoder", "driver: sim_encoder, zero_rad: 0.1")
    assert other != FOLLOWER.text
    with pytest.raises(InputError, match="recorded with a different device: zero_rad was None"):
        open_recorded(job.session, "encoder", parse_robot_file(other, FOLLOWER.path))


def probed(folder, robot, hidden, name):
    scenario = load_scenario({"seed": 5, "hidden": hidden})
    plan = ProbingPlan(speeds_m_s=[0.1], hold_s=0.3)
    run_probing(ProbingJob(robot, folder / name, plan, scenario=scenario, online=None)).raise_for_failure()
    found = estimate_with(open_source(folder / name).tared(["contact"])[0], "kelvin_voigt", ["lsq"])
    return next(
        parameter.value for parameter in found.estimates[0].parameters if parameter.name == "stiffness.k"
    )


def test_calibration_improves_the_estimates_of_a_probing_run(tmp_path):
    """The object is 500 N/m; the sensor shows 6 % too much, the joints' zeros are off by up to 0.05 rad."""
    hidden = [
        {"effect": GAIN, "channel": "contact", "gain": 1.06},
        {"effect": BIAS, "channel": "contact", "bias": 1.0},
        *WRONG_ZEROS,
    ]
    shutil.copytree(FOLLOWER.path.parent, tmp_path / "arm")
    plain = load_robot_file(tmp_path / "arm" / "follower.yaml")
    force_job, force_fit = weighed(tmp_path, hidden, 1, plain)
    encoder_job = job_in(tmp_path, "encoder", hidden, 1, plain)
    runs.run_pose(encoder_job)
    zeros = fit_encoder(opened(encoder_job), 3, plain.home_rad, 1e-3)
    arm = tmp_path / "arm"
    write_text(arm / "force.yaml", made(force_job, force_fit).to_yaml())
    write_text(arm / "encoder.yaml", made(encoder_job, zeros).to_yaml())
    named = arm / "calibrated.yaml"
    named.write_text(plain.text + "\ncalibration: {force: force.yaml, encoder: encoder.yaml}\n")
    calibrated = load_robot_file(named)
    without, with_them = (
        abs(probed(tmp_path, robot, hidden, f"{number}.mcap") - 500.0)
        for number, robot in enumerate((plain, calibrated))
    )
    assert without > 20.0
    assert with_them < 2.0
    kept = Session.open(tmp_path / "1.mcap").metadata.calibration
    assert kept == load_calibrations(calibrated, datetime.now(UTC)).text
    assert "scale" in kept


def test_estimation_takes_the_tilt_from_the_session(tmp_path, excited):
    job, hidden, fit = excited
    shutil.copytree(FOLLOWER.path.parent, tmp_path / "arm")
    calibration = fits.make_calibration("gravity", fit, FOLLOWER, job.session, 365.0)
    write_text(tmp_path / "arm" / "gravity.yaml", calibration.to_yaml())
    path = tmp_path / "arm" / "tilted.yaml"
    path.write_text(FOLLOWER.text + "\ncalibration: {gravity: gravity.yaml}\n")
    pose = job_in(tmp_path, "encoder", [], robot=load_robot_file(path))
    runs.run_pose(pose)
    gravity = arm_of(opened(pose)).gravity_m_s2
    assert gravity[0] == pytest.approx(9.81 * np.sin(hidden["pitch"]), abs=1e-2)
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
