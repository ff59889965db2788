"""Channels from ticks of a small simulator."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.contact import contact_rows, find_contacts
from palpate.estimation.data.tick_channels import contact_channels, join_ticks, joint_channels
from palpate.estimation.data_quality import reject_reason
from palpate.estimation.estimate_channel import fitting_rows
from palpate.estimation.study.estimates import estimate_with
from palpate.render.estimates import remarks
from palpate.robot_io.types import Status
from tests.estimation.little_probe import NOISE_N, Probe, hunt_crossley, kelvin_voigt, probe, ticks

SURFACE_M = 0.4321


@cache
def recorded():
    return probe(kelvin_voigt(800.0, 40.0), surface_m=SURFACE_M)


def contact(truth, **changed):
    """The one contact of a probe with changed columns."""
    (channel,) = contact_channels(ticks(truth, **changed), tared=False)
    return channel


def test_contact_has_depth_speed_and_force():
    channel, truth = contact(recorded()), recorded()
    assert (channel.name, channel.kind) == ("contact", ChannelKind.CONTACT)
    np.testing.assert_allclose(channel.position, truth.true_along_m - SURFACE_M, atol=2e-5)
    np.testing.assert_array_equal(channel.effort, truth.force_n)
    rows = fitting_rows(channel)
    assert np.std(channel.velocity[rows] - truth.true_speed_m_s[rows]) < 1e-3


def test_surface_is_detected_within_its_error():
    for seed in range(3):
        surface = contact(probe(kelvin_voigt(800.0, 40.0), surface_m=SURFACE_M, seed=seed)).surface
        assert abs(surface.position_m - SURFACE_M) < 4 * surface.std_err_m < 1e-4
    surface = contact(probe(hunt_crossley(5000.0, 8000.0, 1.4), surface_m=SURFACE_M)).surface
    assert 0 <= surface.position_m - SURFACE_M < 1e-3


def test_touch_hardly_disturbs_the_velocity():
    """A dashpot takes the speed away within milliseconds."""
    truth = probe(kelvin_voigt(500.0, 100.0), surface_m=SURFACE_M)
    channel = contact(truth)
    touches = [np.flatnonzero(fitting_rows(channel) & (channel.run == run))[:8] for run in channel.runs]
    after = np.concatenate(touches)
    assert np.std(channel.velocity[after] - truth.true_speed_m_s[after]) < 0.02 * 0.15


def test_rows_in_contact_are_chosen_by_time_and_not_by_force():
    truth = recorded()
    rows = contact_rows(truth.force_n, truth.run, truth.phase)
    true_n = 800.0 * (truth.true_along_m - SURFACE_M) + 40.0 * truth.true_speed_m_s
    pressed = (truth.true_along_m > SURFACE_M) & (true_n > 0)
    assert not rows[~pressed].any()
    assert rows[pressed].mean() > 0.97
    for found in find_contacts(truth.force_n, truth.run, truth.phase):
        assert np.all(np.diff(found.rows) == 1)
        assert found.noise_n == pytest.approx(NOISE_N, rel=0.3)


def test_bounces_and_offsets_are_no_contact():
    force = np.concatenate([np.zeros(50), np.full(30, 5.0), np.zeros(20), np.full(100, 5.0), np.zeros(50)])
    force = force + 0.02 * np.random.default_rng(0).standard_normal(len(force))
    phase = np.where(np.arange(len(force)) < 50, Phase.FREE_AIR, Phase.LOADING)
    rows = contact_rows(force, np.zeros(len(force), int), phase)
    assert not rows[80:100].any()
    assert rows[55:75].all()
    assert rows[105:195].all()
    truth = recorded()
    retracted = truth.phase == Phase.RETRACT
    held = replace(truth, force_n=np.where(retracted, np.maximum(truth.force_n, 0.3), truth.force_n))
    assert abs(contact(held).surface.position_m - SURFACE_M) < 1e-4
    air = truth.phase == Phase.FREE_AIR
    only_air = Probe(**{name: values[air] for name, values in vars(truth).items()})
    assert contact_channels(ticks(only_air), tared=False) == ()


def test_late_force_sample_gets_the_motion_of_its_time():
    late_s = 0.0004
    truth = recorded()
    at = truth.time_s + late_s
    shifted = 800.0 * np.interp(at, truth.time_s, truth.true_along_m - SURFACE_M)
    channel = contact(truth, force_at_s=at)
    rows = fitting_rows(channel)
    np.testing.assert_allclose(800.0 * channel.position[rows], shifted[rows], atol=0.02)
    np.testing.assert_array_equal(channel.time_s, at)


def test_faulty_samples_and_ticks_between_runs_are_left_out():
    truth = recorded()
    status = np.zeros(len(truth.time_s), np.int32)
    status[::2] = Status.STALE
    channel = contact(truth, force_status=status)
    assert len(channel) == np.count_nonzero(status == Status.OK)
    np.testing.assert_array_equal(channel.effort, truth.force_n[1::2])
    between = np.where(truth.phase == Phase.FREE_AIR, -1, truth.run)
    assert len(contact(truth, run=between.astype(np.int32))) == np.count_nonzero(between >= 0)


def test_two_places_are_two_channels():
    truth = recorded()
    first, second = contact_channels(ticks(truth, np.where(truth.run < 2, 0.40, 0.45)), tared=False)
    assert (first.name, second.name) == ("contact_1", "contact_2")
    np.testing.assert_array_equal(first.runs, [0, 1])
    np.testing.assert_array_equal(second.runs, [2])


def test_joints_carry_the_whole_arm_motion():
    truth = recorded()
    channels = joint_channels(ticks(truth))
    assert [channel.name for channel in channels] == ["joint_1", "joint_2", "joint_3"]
    second = channels[1]
    assert second.kind is ChannelKind.REVOLUTE
    np.testing.assert_array_equal(second.effort, 0.2 * truth.force_n)
    np.testing.assert_array_equal(second.position, -2 * truth.true_along_m)
    np.testing.assert_array_equal(second.context["joint_velocity"][:, 1], second.velocity)
    assert second.context["press_direction_world"].shape == (len(second), 3)
    np.testing.assert_allclose(second.velocity, -2 * truth.true_speed_m_s, atol=0.02)


def test_torque_sampled_between_positions_does_not_spoil_the_acceleration():
    """Positions interpolated to its time would share their errors with their neighbours, and mislead."""
    truth = recorded()
    counts = np.round(np.outer(truth.true_along_m, [1.0, -2.0, 0.5]) / 7.7e-6) * 7.7e-6
    same, between = (
        joint_channels(ticks(truth, joint_position_rad=counts, torque_at_s=truth.time_s - late_s))[1]
        for late_s in (0.0, 0.0005)
    )
    expected = np.interp(between.time_s, same.time_s, same.acceleration)
    np.testing.assert_allclose(between.acceleration, expected, atol=1e-9)
    moved = np.interp(truth.time_s - 0.0005, truth.time_s, -2 * truth.true_along_m)
    np.testing.assert_allclose(between.position, moved, atol=1e-5)


def test_move_belongs_to_the_next_run_and_useless_phases_to_none():
    truth = recorded()
    run, phase = truth.run.copy(), truth.phase.copy()
    moving = np.flatnonzero(truth.run == 1)[:40]
    run[moving], phase[moving] = -1, Phase.MOVE
    phase[-30:] = Phase.STOPPED
    channel = joint_channels(ticks(truth, run=run.astype(np.int32), phase=phase.astype(np.int32)))[0]
    assert len(channel) == len(truth.time_s) - 30
    np.testing.assert_array_equal(channel.run[moving], 1)


def test_joint_knows_the_contact_point_and_has_no_force_in_free_air():
    truth = recorded()
    biased = joint_channels(ticks(truth, force_n=truth.force_n + 0.7))[0].context["contact_force"]
    assert biased == pytest.approx(joint_channels(ticks(truth))[0].context["contact_force"])
    in_air = truth.phase == Phase.FREE_AIR
    assert abs(np.mean(biased[in_air])) < 0.1 * NOISE_N
    assert biased.max() == pytest.approx(truth.force_n.max(), rel=0.02)
    touching = joint_channels(ticks(truth))[0].context["touching"] == 1.0
    assert np.mean(touching) > 0.2
    assert np.all(truth.force_n[touching] > 0.0)
    assert not touching[truth.phase == Phase.FREE_AIR].any()


def test_joint_ignores_presses_in_another_direction():
    """The surface answers along its normal; only one of two directions can be that."""
    straight, tilted = ticks(recorded()), [-0.64, 0.0, -0.77]
    turned = ticks(recorded(), press_direction_world=np.tile(tilted, (len(straight), 1)))
    whole, of_both = joint_channels(straight)[0], joint_channels(join_ticks([straight, turned]))[0]
    is_first = np.arange(len(of_both)) < len(whole)
    first, second = of_both.select(is_first), of_both.select(~is_first)
    np.testing.assert_array_equal(first.effort, whole.effort)
    assert not second.context["touching"].any()
    assert np.abs(second.context["contact_force"]).max() < 0.3 * whole.context["contact_force"].max()
    assert len(second) > 0.2 * len(whole)  # what surrounds the presses is kept
    assert len(joint_channels(turned)[0]) == len(whole)  # of which nothing else is known
    assert len(joint_channels(turned, straight["press_direction_world"][0])[0]) == len(second)


def test_contact_ignores_presses_in_another_direction():
    straight = ticks(recorded())
    turned = ticks(recorded(), press_direction_world=np.tile([-0.64, 0.0, -0.77], (len(straight), 1)))
    (of_both,) = contact_channels(join_ticks([straight, turned]), tared=False)
    (alone,) = contact_channels(straight, tared=False)
    assert of_both.name == "contact"
    np.testing.assert_array_equal(of_both.effort, alone.effort)
    assert of_both.import_warnings[0].startswith("3 of 6 presses differ in direction from the first")
    assert not alone.import_warnings


def test_contact_of_tilted_presses_alone_is_not_judged():
    """The tip of a session slides along x by a share of its depth, or moves so in free air already."""
    truth = recorded()
    depth_m = np.maximum(truth.true_along_m - SURFACE_M, 0.0)
    wobble_m = 0.3 * (truth.true_along_m - SURFACE_M)
    for across_m, is_tilted in ((0.3 * depth_m, True), (0.05 * depth_m, False), (wobble_m, False)):
        (found,) = contact_channels(ticks(truth, 0.4 + across_m), tared=False)
        assert ("slid along the surface" in (reject_reason(found) or "")) is is_tilted


def test_late_force_sample_is_aligned_with_the_torque():
    truth = recorded()
    late_s = 0.0004
    at_torque, at_force = truth.time_s - late_s, truth.time_s
    made = ticks(truth, torque_at_s=at_torque, force_at_s=at_force, force_n=20.0 * truth.time_s)
    pressed = joint_channels(made)[0].context["contact_force"]
    together = ticks(truth, torque_at_s=at_torque, force_at_s=at_torque, force_n=20.0 * at_torque)
    wanted = joint_channels(together)[0].context["contact_force"]
    np.testing.assert_allclose(pressed[5:], wanted[5:], atol=0.1 * 20.0 * late_s)


def test_adhesion_does_not_bias_stiffness_or_surface():
    truth = probe(kelvin_voigt(800.0, 40.0), surface_m=SURFACE_M, noise_n=0.005)
    pulled = replace(truth, force_n=truth.force_n - 0.8 * (truth.true_along_m > SURFACE_M))
    (channel,) = contact_channels(ticks(pulled), tared=True)
    found = estimate_with(channel, "kelvin_voigt", ["lsq"])
    assert found.best["stiffness.k"].value == pytest.approx(800.0, rel=2e-3)
    assert found.best["contact_offset.offset"].value > 5e-4
    assert found.surface_of(found.best).position_m <= channel.surface.deepest_m
    assert any("below the touch" in line for line in remarks(found, {}))
