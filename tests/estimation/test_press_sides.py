"""Signs of displacement and force, and elements that pull as well as push."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.channels import import_streams
from palpate.estimation.data.choose_columns import is_pressed
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.presses import cut_presses, press_sides
from palpate.estimation.data_quality import quality_warnings, reject_reason
from palpate.estimation.estimate_channel import estimate_channel
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.models import MODELS
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.channels import channels_for_model
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import SessionMetadata, write_session
from tests.estimation.press_tables import imported
from tests.estimation.presses import kelvin_voigt, motion
from tests.few_effects import try_few_effects

T = np.arange(3000) * 0.005
RUN = np.repeat([0, 1, 2], 1000)
W = 3.0 + RUN
X, V = 0.02 * np.sin(W * T), 0.02 * W * np.cos(W * T)
NOISE = np.random.default_rng(0).normal(0.0, 0.05, len(T))
SPRING, DAMPER, FRICTION = 800.0 * X + 5.0 * V, 60.0 * V + 5.0 * X, 8.0 * np.sign(V) + 3.0 * V
PRESS_T, PRESS_X, PRESS_V, PRESS_RUN = motion(np.random.default_rng(0))
PUSH = kelvin_voigt(PRESS_X, PRESS_V) + np.random.default_rng(1).normal(0.0, 0.05, len(PRESS_X))


def element(force, options=None, **changed):
    columns = {"time_s": T, "displacement_m": X, "force_N": force + NOISE, "run": RUN} | changed
    return imported(options, **columns)


def test_pulling_spring_is_held_at_both_ends():
    found = element(SPRING)
    (channel,) = found.channels
    assert channel.kind is ChannelKind.CONTACT
    assert channel.engaged.all()
    assert "'force_N' take both signs at the same times" in found.notes[0]
    assert "to read them as a contact, add --column displacement=displacement_m" in found.notes[0]
    assert reject_reason(channel) is None
    assert quality_warnings(channel) == []
    model = MODELS["kelvin_voigt"]().build(ModelContext())
    estimate = estimate_channel(channel, model, ESTIMATORS["lsq"](), rng=np.random.default_rng(0))
    assert estimate["stiffness.k"].value == pytest.approx(800.0, rel=0.01)
    assert estimate["damping.c"].value == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize("force", [DAMPER, FRICTION], ids=["damper", "friction"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_damper_is_a_linear_axis_for_either_force_sign(force, sign):
    found = element(sign * force)
    (channel,) = found.channels
    assert channel.kind is ChannelKind.PRISMATIC
    assert (
        "read as a linear axis; to read them as a contact, add --column displacement=displacement_m"
        in found.notes[-1]
    )
    assert np.corrcoef(channel.velocity, channel.effort)[0, 1] > 0.8
    assert reject_reason(channel) is None


def test_spring_and_damper_describe_a_linear_axis_too():
    source = open_source({"time_s": T, "displacement_m": X, "force_N": DAMPER + NOISE, "run": RUN})
    (axis,) = channels_for_model(source, "kelvin_voigt")
    assert axis.kind is ChannelKind.PRISMATIC
    model = MODELS["kelvin_voigt"]().build(ModelContext())
    estimate = estimate_channel(axis, model, ESTIMATORS["lsq"](), rng=np.random.default_rng(0))
    assert estimate["damping.c"].value == pytest.approx(60.0, rel=0.01)
    turning = open_source({"time_s": T, "position_rad": X, "torque_Nm": DAMPER, "run": RUN})
    with pytest.raises(InputError, match="describes a contact, but the channels are: joint_1"):
        channels_for_model(turning, "kelvin_voigt")


def test_user_chooses_contact_or_axis_and_one_spring_is_not_cut():
    contact = element(SPRING, ImportOptions(columns={"displacement": "displacement_m"})).channels[0]
    assert contact.touching is None
    axis = element(SPRING, ImportOptions(columns={"position": "displacement_m"})).channels[0]
    assert axis.kind is ChannelKind.PRISMATIC
    found = imported(time_s=T, displacement_m=0.02 * np.sin(3.0 * T), force_N=16.0 * np.sin(3.0 * T) + NOISE)
    assert len(found.channels[0].runs) == 1
    assert reject_reason(found.channels[0]) is None


def test_pulling_element_is_stored_as_one(tmp_path):
    write_session(tmp_path / "s.mcap", import_streams(element(SPRING)), SessionMetadata(), ())
    (again,) = open_source(tmp_path / "s.mcap").channels
    assert again.engaged.all()


@pytest.mark.parametrize(
    ("way", "force", "said"),
    [
        (1.0, 1.0, ""),
        (-1.0, -1.0, "are negative in compression, so their signs are reversed"),
        (
            1.0,
            -1.0,
            "negative in compression, so its sign is reversed; to prevent this, add --unit force=1N",
        ),
        (
            -1.0,
            1.0,
            "negative in compression, so its sign is reversed; to prevent this, add --unit displacement=1m",
        ),
    ],
)
def test_press_is_turned_so_that_compression_is_positive(way, force, said):
    x = PRESS_X + 0.0035  # hardly any way in free air, which would be on the other side
    found = imported(time_s=PRESS_T, run=PRESS_RUN, displacement_m=way * x, force_N=force * PUSH)
    (channel,) = found.channels
    np.testing.assert_allclose(channel.position, x)
    np.testing.assert_allclose(channel.effort, PUSH)
    assert said in " ".join(found.notes)
    assert bool(said) == bool(found.notes)


@pytest.mark.parametrize(("way", "sign"), [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
@pytest.mark.parametrize("from_m", [0.35, -0.35])
def test_coordinate_counts_from_where_the_force_begins(way, sign, from_m):
    """A robot moves up or down; a testing machine may count compression negative."""
    found = imported(time_s=PRESS_T, run=PRESS_RUN, z_m=from_m + way * PRESS_X, force_N=sign * PUSH)
    (channel,) = found.channels
    np.testing.assert_allclose(channel.effort, PUSH)
    assert channel.position.max() == pytest.approx(PRESS_X.max(), abs=3e-4)
    assert float(re.search(r"the zero of 'z_m' is set to (\S+) m", found.notes[-1])[1]) == pytest.approx(
        from_m, abs=3e-4
    )
    assert reject_reason(channel) is None
    assert not [warning for warning in quality_warnings(channel) if "deepest" in warning]


def test_pressed_recording_keeps_its_zero_and_a_unit_factor_its_sign():
    x = 0.004 + 0.002 * np.sin(W * T)
    found = imported(time_s=T, displacement_m=x, force_N=500.0 * x + NOISE, run=RUN)
    np.testing.assert_allclose(found.channels[0].position, x)
    assert not found.notes
    options = ImportOptions(units={"force": "1N"})
    (channel,) = imported(
        options, time_s=PRESS_T, run=PRESS_RUN, displacement_m=PRESS_X, force_N=-PUSH
    ).channels
    np.testing.assert_allclose(channel.effort, -PUSH)
    assert "check the signs of force and displacement: --unit force=-1N " in reject_reason(channel)
    reversed_twice = replace(channel, units=channel.units | {"force": "-.5N"})
    assert "--unit force=.5N reverses the force" in reject_reason(reversed_twice)


def test_absolute_force_keeps_its_sign_and_other_forces_are_named():
    """A needle was pulled out: its largest force was at no depth, so the sign of a magnitude was reversed."""
    t = np.arange(0.0, 2.0, 0.005)
    depth_mm = 1.4 * np.clip(np.minimum(4.0 * t, 3.0 - 2.0 * t), 0.0, 1.0)
    force = np.where(t > 1.0, 0.2 * (t - 1.0) ** 2, -0.004)
    columns = {"time_s": t, "insertion_depth_mm": depth_mm, "absolute_force_N": np.abs(force), "rf3_N": force}
    found = imported(**columns)
    np.testing.assert_allclose(found.channels[0].effort, np.abs(force))
    notes = " ".join(found.notes)
    assert "keeps its sign, because the name says that the column holds absolute values" in notes
    said = "read as the force, not 'rf3_N'; if another column holds the force, add --column force=COLUMN"
    assert said in notes
    chosen = imported(ImportOptions(columns={"force": "rf3_N"}), **columns)
    np.testing.assert_allclose(np.abs(chosen.channels[0].effort), np.abs(force))


def test_free_air_and_a_sticky_object_are_one_sided():
    sticks = np.where((PRESS_X < 0.0) & (PRESS_X > -5e-4) & (PRESS_V < 0.0), -3.0, 0.0)
    for force in (PUSH, PUSH + sticks, PUSH - 1.0):
        assert press_sides(PRESS_X, force) == press_sides(PRESS_X, PUSH)
        assert not press_sides(PRESS_X, force).two_sided


@pytest.mark.parametrize(
    ("share", "zero_m"), [(share, zero_m) for share in (0.3, 0.6, 0.8, 0.95, 1.0) for zero_m in (0.0, -0.01)]
)
def test_object_that_pulls_until_it_tears_off_is_one_sided(share, zero_m):
    """On its way out it pulls over most of the way in free air, as a soft object pulls a small probe."""
    x, v = 0.002 + 0.006 * np.sin(W * T), np.cos(W * T)
    pulls = np.where((x < 0.0) & (x > share * x.min()) & (v < 0.0), 600.0 * x, 0.0)
    assert not press_sides(x - zero_m, 500.0 * np.maximum(x, 0.0) + pulls + NOISE).two_sided
    assert press_sides(x - zero_m, 500.0 * x + NOISE).two_sided


@pytest.mark.parametrize(
    ("columns", "force", "kind", "noted"),
    [
        ({"position": PRESS_X}, PUSH, ChannelKind.CONTACT, True),
        ({"Position [m]": PRESS_X}, PUSH, ChannelKind.CONTACT, True),
        ({"Position [m]": PRESS_X}, PRESS_V, ChannelKind.PRISMATIC, True),
        ({"position_m": PRESS_X}, PUSH, ChannelKind.PRISMATIC, True),
        ({"position_m": PRESS_X}, PRESS_V, ChannelKind.PRISMATIC, False),  # the name that palpate writes
    ],
)
def test_position_in_meters_is_a_press_or_an_axis_by_its_force(columns, force, kind, noted):
    options = ImportOptions(units={"position": "m"} if "position" in columns else {})
    found = imported(options, time_s=PRESS_T, run=PRESS_RUN, force_N=force, **columns)
    assert found.channels[0].kind is kind
    assert bool(found.notes) is noted


def test_ambiguous_position_is_asked_about():
    options = ImportOptions(units={"position": "mm"})
    weight = np.full(len(PRESS_X), 9.0) + 0.01 * PRESS_V
    with pytest.raises(InputError, match=r"press or to a linear axis; .* --column displacement=position"):
        imported(options, time_s=PRESS_T, run=PRESS_RUN, force_N=weight, position=PRESS_X)


def test_sign_of_a_softening_force_is_oriented():
    x = np.linspace(0.0, 0.04, 400)
    force = np.where(x < 0.004, 2500.0 * x, 10.0 - 150.0 * (x - 0.004)) + np.sin(900.0 * x)
    sides = press_sides(x, force)
    assert (sides.displacement, sides.force, sides.two_sided) == (1.0, 1.0, False)
    sides = press_sides(-x, -force)
    assert (sides.displacement, sides.force) == (-1.0, -1.0)
    x = np.linspace(0.0, 0.04, 6000)
    assert press_sides(x, 0.4 - 35.0 * (x % 0.021)).displacement == 1.0


def test_snapping_force_in_one_direction_is_one_press():
    x, one = np.linspace(0.0, 0.04, 6000), np.zeros(6000, dtype=np.int64)
    assert cut_presses(5.0 - 230.0 * (x % 0.0201), x, one, np.arange(6000.0))[0].max() == 0
    twice = np.tile(0.02 - np.abs(x - 0.02), 2)
    assert cut_presses(200.0 * twice, twice, np.tile(one, 2), np.arange(12000.0))[0].max() == 1


@pytest.mark.parametrize("kind", ["noise", "snap-in"])
def test_noise_or_a_snap_in_moves_no_cut_between_presses(kind):
    depth = np.interp(np.arange(400.0), [0, 40, 120, 200, 320, 400], [-2.0, -2.0, 4.0, 4.0, -2.0, -2.0])
    force = np.tile(np.maximum(depth, 0.0), 2)
    depth = np.tile(depth, 2)
    piece, time_s = np.zeros(800, dtype=np.int64), np.arange(800.0)
    (cut,) = np.flatnonzero(np.diff(cut_presses(force, depth, piece, time_s)[0]))
    disturbed = force + np.random.default_rng(0).normal(0.0, 0.3, 800)
    if kind == "snap-in":
        disturbed = force - 1.5 * (np.isin(np.arange(800), np.arange(455, 466)))
    (moved,) = np.flatnonzero(np.diff(cut_presses(disturbed, depth, piece, time_s)[0]))
    assert abs(moved - cut) <= 25


def test_cut_between_presses_of_an_object_that_sticks_is_at_the_pause():
    depth = np.interp(np.arange(400.0), [0, 40, 120, 200, 320, 400], [-2.0, -2.0, 4.0, 4.0, -2.0, -2.0])
    force = np.where(depth > 0.0, depth, 0.0)
    returning = np.arange(400) > 200
    force[returning & (depth < 1.0) & (depth > -0.5)] = -1.0  # the object pulls until it detaches
    time_s = np.concatenate([np.arange(400.0), 2000.0 + np.arange(400.0)])
    piece = np.zeros(800, dtype=np.int64)
    run, presses = cut_presses(np.tile(force, 2), np.tile(depth, 2), piece, time_s)
    assert presses == 1
    assert np.flatnonzero(np.diff(run)) == [399]


def test_pull_that_tears_before_zero_counts_from_its_first_force():
    x = np.linspace(-0.0246, 0.0054, 1800)
    force = np.where(x < -0.0226, 1.1e6 * (x + 0.0246), np.where(x < -0.013, 1700.0, -5.0))
    sides = press_sides(x, force + np.random.default_rng(0).normal(0.0, 1.0, 1800))
    assert (sides.displacement, sides.force) == (1.0, 1.0)
    assert sides.zero_m == pytest.approx(-0.0246, abs=2e-4)


@pytest.mark.parametrize("start_m", [0.0, -1e-6, 1e-6])
def test_displacement_from_about_zero_on_is_not_turned(start_m):
    way = start_m + np.linspace(0.0, 5e-3, 400)
    softening = 8.0 * np.exp(-way / 1e-3)  # the force is largest at the start, and falls
    assert press_sides(way, softening).displacement == 1.0


def test_static_friction_peak_is_no_press_and_a_long_hold_no_force_onset():
    way = np.concatenate([np.zeros(50), np.linspace(0.0, 0.1, 950)])
    friction = np.where(way > 0.0, 3.0 + 2.0 * np.exp(-way / 5e-4), 0.0)
    friction[50:54] = [1.0, 2.5, 4.0, 5.0]
    assert not is_pressed(way, friction)
    assert is_pressed(way, 100.0 * way)
    way = np.concatenate([np.linspace(-22e-3, -1e-3, 100), np.full(20_000, -1e-3)])
    force = np.concatenate([200.0 * np.linspace(0.0, 21e-3, 100), np.full(20_000, 3.4)])
    assert press_sides(way, force).zero_m == pytest.approx(-22e-3, abs=5e-4)


HOLD_T = np.concatenate([np.arange(20) * 0.001, 0.02 + np.geomspace(0.01, 1000.0, 580)])
# A jaw that creeps after a step, as a machine prints it
GAP_M = np.round(0.03133 + 2e-5 * -np.expm1(-HOLD_T), 7)
RELAXING = 20.0 + 18.0 * np.exp(-HOLD_T / 30.0) + np.random.default_rng(2).normal(0.0, 0.01, len(HOLD_T))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_relaxing_stretched_fiber_is_held_at_both_ends(sign):
    found = imported(
        time_s=HOLD_T, displacement_m=GAP_M, force_N=sign * RELAXING, run=np.zeros(len(HOLD_T), int)
    )
    (channel,) = found.channels
    assert channel.engaged.all()
    assert "'force_N' varies at every displacement" in found.notes[0]
    assert "compression" not in found.notes[0]  # nothing is compressed
    assert ("the sign of 'force_N' is reversed; to prevent this, add --unit force=1N" in found.notes[0]) == (
        sign < 0.0
    )
    assert reject_reason(channel) is None
    np.testing.assert_allclose(channel.effort, RELAXING)  # a spring from the gap's zero on has this sign


@pytest.mark.parametrize(
    ("word", "is_engaged"), [("displacement", False), ("depth", False), ("elongation", True)]
)
def test_user_states_whether_an_element_is_held_at_both_ends(word, is_engaged):
    x = 0.002 + 0.006 * np.sin(W * T)
    table = {"time_s": T, "u_m": x, "force_N": 500.0 * np.maximum(x, 0.0) + NOISE, "run": RUN}
    (channel,) = open_source(table, ImportOptions(columns={word: "u_m"})).channels
    assert channel.engaged.all() == is_engaged
    strip = {"time_s": HOLD_T, "u_m": GAP_M, "force_N": RELAXING}
    (channel,) = open_source(strip, ImportOptions(columns={word: "u_m"})).channels
    assert (channel.touching is None) == (word == "depth")


@pytest.mark.parametrize(
    ("way", "sign", "length_m"), [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, 1.0, 0.03)]
)
def test_relaxation_of_a_clamped_strip_that_pulls_back_is_named(way, sign, length_m, monkeypatch):
    """A machine stretches a strip in cycles and returns it faster than it recovers, never beyond its zero."""
    rows = (60, 90, 75)  # of a cycle in each run
    part = np.concatenate([np.arange(8 * count) / count % 1.0 for count in rows])
    x = 1.3e-3 * np.clip(2.0 - np.abs(6.0 * part - 2.5), 0.0, 1.0)
    step_s, tau_s = 0.02, 1.0
    kept = np.exp(-step_s / tau_s)
    relaxing = lfilter([tau_s * (1.0 - kept) / step_s], [1.0, -kept], np.diff(x, prepend=0.0))
    force = 500.0 * x + 900.0 * relaxing + np.random.default_rng(5).normal(0.0, 0.01, len(x))
    time_s, run = step_s * np.arange(len(x)), np.repeat([0, 1, 2], 8 * np.array(rows))
    table = {"time_s": time_s, "displacement_m": length_m + way * x, "force_N": sign * force, "run": run}
    few = ("adhesion", "bias", "contact_offset", "drift", "dry_friction", "stress_relaxation")
    try_few_effects(monkeypatch, few=few)
    (found,) = ModelStudy(open_source(table)).diagnose().channels
    effects = {"stress_relaxation", "contact_offset"} if length_m else {"stress_relaxation"}
    assert {entry.effect for entry in found.accepted} == effects
    truths = {"stiffness.k": 500.0, "stress_relaxation.k1": 900.0, "stress_relaxation.tau": tau_s}
    values = {name: found.final.parameters[name].value for name in truths}
    assert values == pytest.approx(truths, rel=0.02)


def test_pure_force_noise_is_not_two_sided():
    noise = np.random.default_rng(3).normal(0.0, 0.05, len(PRESS_X))
    assert not press_sides(PRESS_X + 0.0035, noise).two_sided


@pytest.mark.parametrize(("middle_m", "warned"), [(-0.66e-3, True), (0.02e-3, False)])
def test_element_far_from_its_zero_is_said_to_depend_on_it(middle_m, warned):
    """A probe that slides under a load, and whose height is a coordinate of the machine."""
    way = middle_m + 3e-5 * np.sin(W * T)
    read = element(-2.0 + 0.5 * np.sin(3.0 * W * T), displacement_m=way)
    said = " ".join(read.notes)
    assert ("the stiffness depends on where the displacement is zero" in said) == warned, said
