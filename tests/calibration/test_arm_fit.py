"""Arm fit: drive parameters of synthetic drives are recovered."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.calibration.arm_fit import ArmMotion, fit_arm, implausible_arm
from palpate.calibration.arm_motion import TORQUE_MOTION, FourierPath, choose_path
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.calibration.applied import gravity_base_m_s2
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
ROBOT = load_robot_file(ARMS / "follower" / "follower.yaml")
BODY = RigidBody.from_urdf(ROBOT.urdf_path, ROBOT.tip_frame)


HOME_RAD, UPRIGHT_RAD = np.array(ROBOT.home_rad), np.array([1.57, 0.0, 0.0])


def chosen(start_rad=HOME_RAD, limits=ROBOT.limits):
    rng = np.random.default_rng(0)
    return choose_path(BODY, start_rad, limits, settings=TORQUE_MOTION, rng=rng)


@pytest.fixture(scope="module")
def path():
    return chosen()


def measured(
    path, rng, *, pitch=0.0, gain=1.0, offset=0.0, coulomb=0.0, viscous=0.0, noise=0.01, duration=None
):
    """What drives would show along the path, from another model of the arm's weight than the fit uses."""
    times = np.arange(0.0, duration or path.duration_s, 1e-3)
    q, v, a = path.sample(times)
    body = RigidBody.from_urdf(ROBOT.urdf_path, ROBOT.tip_frame, gravity_base_m_s2(pitch, 0.0))
    true = body.inverse_dynamics_batch(q, v, a)
    true = true + coulomb * np.sign(v) + viscous * v
    shown = (true - offset) / gain
    return ArmMotion(times, q, v, a, shown + rng.normal(0, noise, shown.shape), shown)


def test_drive_parameters_are_identified_together(path):
    hidden = {
        "gain": np.array([0.85, 1.1, 1.2]),
        "offset": np.array([0.2, -0.1, 0.03]),
        "coulomb": np.array([0.4, 0.2, 0.02]),
        "viscous": np.array([0.3, 0.1, 0.01]),
    }
    fit = fit_arm(measured(path, np.random.default_rng(1), pitch=0.04, **hidden), BODY)
    found = zip(hidden.items(), (fit.gain, fit.offset_nm, fit.coulomb_nm, fit.viscous_nms_rad), strict=True)
    for (name, true), estimate in found:
        assert np.all(np.abs(estimate.value - true) < 4 * estimate.std_err), name
        assert np.all(estimate.std_err < 0.02), name
    assert fit.tilt_rad.value[0] == pytest.approx(0.04, abs=4 * fit.tilt_rad.std_err[0])
    assert fit.tilt_rad.std_err[0] < 1e-3


def test_two_standard_errors_cover_95_percent(path):
    """30 recordings of 10 values; the band is wide enough for that number of draws."""
    clean = measured(path, np.random.default_rng(0), noise=0.0, duration=15.0)
    covered = []
    for seed in range(30):
        noise = np.random.default_rng(seed).normal(0, 0.02, clean.measured_nm.shape)
        fit = fit_arm(replace(clean, measured_nm=clean.measured_nm + noise), BODY)
        for estimate, true in ((fit.gain, 1.0), (fit.offset_nm, 0.0), (fit.coulomb_nm, 0.0)):
            covered += [*(np.abs(estimate.value - true) < 2 * estimate.std_err)]
        covered.append(abs(fit.tilt_rad.value[0]) < 2 * fit.tilt_rad.std_err[0])
    assert 0.90 < np.mean(covered) < 0.99


def test_planar_motion_does_not_identify_roll(path):
    fit = fit_arm(measured(path, np.random.default_rng(2), duration=15.0), BODY)
    assert np.isfinite(fit.tilt_rad.value[0])
    assert np.isnan(fit.tilt_rad.value[1])


def test_late_torque_samples_do_not_bias_friction(path):
    motion = measured(path, np.random.default_rng(3), duration=15.0)
    time_s, q, v, a, measured_nm, sent_nm = vars(motion).values()
    late = ArmMotion(*(part[:-3] for part in (time_s, q, v, a)), measured_nm[3:], sent_nm[3:])
    fit = fit_arm(late, BODY)
    assert fit.delay_s.value == pytest.approx(-0.003, abs=4 * fit.delay_s.std_err)
    assert np.all(np.abs(fit.viscous_nms_rad.value) < 4 * fit.viscous_nms_rad.std_err)


def test_inertia_of_the_rotors_is_not_read_as_gain_or_tilt(path):
    rotors = RigidBody.from_urdf(ROBOT.urdf_path, ROBOT.tip_frame, rotor_inertia_kg_m2=(0.5, 0.5, 0.5))
    clean = measured(path, np.random.default_rng(4), duration=15.0)
    motion = replace(clean, measured_nm=clean.measured_nm + 0.5 * clean.acceleration_rad_s2)
    fit = fit_arm(motion, rotors)
    assert np.all(np.abs(fit.gain.value - 1.0) < 4 * fit.gain.std_err)
    assert abs(fit.tilt_rad.value[0]) < 4 * fit.tilt_rad.std_err[0]
    without = fit_arm(motion, BODY)
    assert np.any(np.abs(without.gain.value - 1.0) > 10 * without.gain.std_err)
    assert without.residual_nm[np.isfinite(without.residual_nm)].std() > 5 * np.nanstd(fit.residual_nm)


class TestImplausible:
    @pytest.fixture(scope="class")
    @staticmethod
    def motion(path):
        return measured(path, np.random.default_rng(5), duration=15.0)

    def test_right_signals_are_plausible(self, motion):
        assert implausible_arm(fit_arm(motion, BODY), gains_are_applied=True) == []

    def test_swapped_channels_are_named(self, motion):
        swapped = replace(motion, measured_nm=motion.measured_nm[:, [1, 0, 2]])
        for gains_are_applied in (True, False):
            try:
                words = "; ".join(
                    implausible_arm(fit_arm(swapped, BODY), gains_are_applied=gains_are_applied)
                )
            except InputError as error:  # a gain may be beyond what can be applied
                words = str(error)
            assert "joint 1: the gain of its torque is" in words
            assert "the torques of two joints are swapped" in words

    def test_reversed_sign_is_refused_with_its_joint(self, motion):
        fit = fit_arm(replace(motion, measured_nm=motion.measured_nm * [-1, 1, 1]), BODY)
        with pytest.raises(InputError, match=r"^joint 1: the gain of its torque is -1.*sign is reversed"):
            implausible_arm(fit, gains_are_applied=True)
        (reason,) = implausible_arm(fit, gains_are_applied=False)
        assert "sign is reversed" in reason

    def test_saturated_signal_is_named(self, motion):
        most = 0.7 * np.abs(motion.measured_nm[:, 0]).max()
        clipped = replace(motion, measured_nm=motion.measured_nm.clip([-most, -99, -99], [most, 99, 99]))
        reasons = implausible_arm(fit_arm(clipped, BODY), gains_are_applied=True)
        assert any("joint 1: its measured torque stays at" in reason for reason in reasons)
        assert not any("joint 2" in reason for reason in reasons)

    def test_drifting_torque_is_implausible(self, motion):
        drift = np.outer(motion.time_s, [0.0, 0.3, 0.0])
        reasons = implausible_arm(
            fit_arm(replace(motion, measured_nm=motion.measured_nm + drift), BODY), gains_are_applied=True
        )
        assert any("joint 2: " in reason for reason in reasons)

    def test_constant_torque_is_refused_with_its_joint(self, motion):
        with pytest.raises(InputError, match="joint 3: its measured torque is always 0 N m"):
            fit_arm(replace(motion, measured_nm=motion.measured_nm * [1, 1, 0]), BODY)


def test_arm_at_rest_is_refused(path):
    still = FourierPath(path.center_rad, np.zeros((3, 1)), np.zeros((3, 1)), 10.0, 20.0)
    with pytest.raises(InputError, match="joint 1 hardly moves"):
        fit_arm(measured(still, np.random.default_rng(0)), BODY)


class TestPath:
    def test_path_stays_within_limits_and_above_the_floor(self, path):
        limits = ROBOT.limits
        floor = BODY.heights_m(np.array(ROBOT.home_rad))[1:].min()
        for time_s in np.linspace(0, path.duration_s, 250):
            motion = path.at(time_s)
            assert np.all(motion.position_rad > limits.position_min_rad)
            assert np.all(motion.position_rad < limits.position_max_rad)
            assert np.all(np.abs(motion.velocity_rad_s) < limits.velocity_rad_s)
            assert BODY.heights_m(motion.position_rad)[1:].min() > floor - 0.02

    def test_profile_derivatives_are_consistent_and_start_at_rest(self, path):
        step = 1e-5
        for time_s in (0.5, 3.9, 17.2, 37.0, 39.9):
            before, here, after = (path.at(time_s + shift) for shift in (-step, 0.0, step))
            slope = (after.position_rad - before.position_rad) / (2 * step)
            bend = (after.velocity_rad_s - before.velocity_rad_s) / (2 * step)
            np.testing.assert_allclose(here.velocity_rad_s, slope, atol=1e-6)
            np.testing.assert_allclose(here.acceleration_rad_s2, bend, atol=1e-6)
        for time_s in (0.0, path.duration_s):
            np.testing.assert_allclose(path.at(time_s).velocity_rad_s, 0.0, atol=1e-9)
            np.testing.assert_allclose(path.at(time_s).position_rad, path.center_rad)

    def test_path_is_repeatable_for_equal_seeds(self, path):
        times = np.linspace(-1.0, path.duration_s + 1.0, 100)
        each = [path.at(time_s) for time_s in times]
        np.testing.assert_allclose(path.sample(times), np.swapaxes(each, 0, 1), atol=1e-12)
        assert np.array_equal(chosen().at(7.0).position_rad, path.at(7.0).position_rad)

    def test_path_is_smaller_near_limits(self):
        small = chosen(UPRIGHT_RAD)
        for time_s in np.linspace(0, small.duration_s, 250):
            assert BODY.heights_m(small.at(time_s).position_rad)[1:].min() > 0.55 - 0.02

    def test_arm_at_its_highest_posture_is_refused(self):
        narrow = ROBOT.limits.model_copy(update={"position_max_rad": (1.0, 2.75, 2.85)})
        with pytest.raises(InputError, match="raise the arm by hand"):
            chosen(UPRIGHT_RAD, narrow)
