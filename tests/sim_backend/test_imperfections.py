"""Hidden effects: one form, silent at strength zero, stable at extremes, drawn by seed."""

import inspect
import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import parse_yaml
from palpate.sim_backend import engines
from palpate.sim_backend.contact_laws import CONTACT_LAWS
from palpate.sim_backend.hidden import STRONGEST, WEAKEST, draw_hidden, hidden_effects, noise_scale
from palpate.sim_backend.imperfection import (
    IMPERFECTIONS,
    ContactImperfection,
    SensorImperfection,
    parse_imperfection,
)
from palpate.sim_backend.noise_scale import CONTACT, channel_of, joint_of
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.sim_backend.world import World
from tests.sim_backend.hidden_parts import ALL
from tests.sim_backend.parts import shipped_arm

SCALE = noise_scale(Scenario())
EVERY_ENGINE = pytest.mark.parametrize("engine", sorted(engines._ENGINES), indirect=True)
# The vocabulary of the project; what is left out is the object's law or the arm's URDF.
VOCABULARY = {
    *("hunt_crossley", "cubic_stiffness", "layered_stiffness", "stress_relaxation", "quadratic_damping"),
    *("adhesion", "plastic_set", "dry_friction", "contact_offset", "tool_compliance"),
    *("viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction"),
    *("load_dependent_friction", "quadratic_friction", "payload", "armature", "gravity_tilt"),
    *("torque_ripple", "joint_spring", "backlash", "joint_elasticity", "torque_gain"),
    *("bias", "drift", "lag", "delay", "saturation", "deadband", "hysteresis", "quantisation", "sensor_gain"),
}


def any_channel(kind):
    """A channel that the effect belongs to, whether probing shows it or not."""
    if issubclass(kind, ContactImperfection):
        return CONTACT
    return "joint_1" if issubclass(kind, SensorImperfection) else "joint_2"


def at_strength(name, strength, channel=None):
    kind = IMPERFECTIONS[name]
    return kind.at_strength(strength, channel or any_channel(kind), SCALE, np.random.default_rng(4))


def test_spring_and_damper_of_a_hidden_hunt_crossley_law_are_equal_at_the_usual_speed():
    """In this law both grow with the contact, so that a damper alone would be another effect."""
    law = at_strength("hunt_crossley", 20.0)
    assert law.stiffness > 0.0
    assert law.damping * SCALE.speed_m_s == pytest.approx(law.stiffness)


@lru_cache(maxsize=8)
def fallen(_engine, name, strength):
    """What a fall shows with an effect of a strength, or with none, in the engine that is chosen now."""
    return fall(at_strength(name, strength) if name else None)


def fall(entry, duration_s=0.1):
    """What the sensors of a falling arm show, its tip on the object at first, and the truth at the end."""
    world = World(shipped_arm("follower"), Scenario().with_hidden([entry] if entry else []))
    world.object.move_surface(world.truth().tip_position_world_m[2] + 0.004)
    shown = []
    for tick in range(1, round(duration_s * 1e3)):
        world.set_torque([8.0 + np.sin(0.3 * tick), 1.5, 0.1 * np.sin(0.5 * tick)])
        world.advance_to(tick * 1e-3)
        samples = (world.encoder, world.torque_sensor, world.force_sensor)
        shown.append(np.concatenate([sensor.read(world.time_s).value for sensor in samples]))
    truth = world.truth()
    world.close()
    return np.array(shown), truth


def test_whole_vocabulary_is_registered():
    assert set(ALL) == VOCABULARY


@pytest.mark.parametrize("name", ALL)
class TestEveryEffect:
    def test_imperfection_is_documented_and_accepts_typical_values(self, name):
        kind = IMPERFECTIONS[name]
        source = inspect.getsource(kind)
        for parameter in kind.parameters():
            said = re.search(rf"(?:# (.*)\n)?    {parameter.name}: .*?(?:# (.*))?\n", source)
            assert f"[{parameter.unit}]" in "".join(filter(None, said.groups()))
            assert parameter.low < parameter.high
        assert {parameter.name for parameter in kind.parameters()} == (
            kind.model_fields.keys() - {"joint", "channel"}
        )
        pages = (Path(__file__).parents[2] / "docs" / "reference" / "effects.md").read_text()
        (row,) = [line for line in pages.splitlines() if line.startswith(f"| `{name}` |")]
        for parameter in IMPERFECTIONS[name].parameters():
            assert f"`{parameter.name}` [{parameter.unit}] {parameter.low:g} to {parameter.high:g}" in row
        kind = IMPERFECTIONS[name]
        place = {"joint": 2} if "joint" in kind.model_fields else {}
        place |= {"channel": "joint_1"} if "channel" in kind.model_fields else {}
        for bound in ("low", "high"):
            values = {parameter.name: getattr(parameter, bound) for parameter in kind.parameters()}
            assert kind(**place, **values).effects(3)
        entry = at_strength(name, 10.0)
        assert parse_imperfection(entry.describe()) == entry
        world = Scenario().with_hidden([entry])
        assert Scenario.load(parse_yaml(world.to_yaml(), "copy")) == world

    @EVERY_ENGINE
    def test_zero_strength_changes_nothing(self, name, engine):
        expected, truth = fallen(engine, None, 0.0)
        shown, at_end = fallen(engine, name, 0.0)
        assert np.array_equal(shown, expected)
        assert np.array_equal(at_end.joint_position_rad, truth.joint_position_rad)

    def test_imperfection_grows_with_its_strength_and_keeps_its_memory_to_one_world(self, name, engine):
        calm, weak, strong = (fallen(engine, *what)[0] for what in ((None, 0.0), (name, 1.0), (name, 30.0)))
        assert np.abs(strong - calm).mean() > np.abs(weak - calm).mean()
        assert np.array_equal(fall(at_strength(name, 30.0))[0], strong)

    def test_imperfection_is_stable_over_its_typical_range(self, name):
        kind = IMPERFECTIONS[name]
        for joint in (1, 3) if "joint" in kind.model_fields else (None,):
            place = {"joint": joint} if joint else {}
            place |= {"channel": CONTACT} if "channel" in kind.model_fields else {}
            values = {parameter.name: parameter.high for parameter in kind.parameters()}
            shown, truth = fall(kind(**place, **values))
            assert np.isfinite(shown).all()
            assert np.abs(truth.joint_velocity_rad_s).max() < 60.0

    def test_nonexistent_joint_is_refused(self, name):
        kind = IMPERFECTIONS[name]
        if "joint" in kind.model_fields:
            entry = at_strength(name, 5.0).model_copy(update={"joint": 4})
        elif "channel" in kind.model_fields:
            entry = at_strength(name, 5.0).model_copy(update={"channel": "joint_4"})
        else:
            return
        with pytest.raises(InputError, match=rf"'{name}'.*4 does not exist; the arm has 3 joints"):
            hidden_effects([entry], 3)


def test_all_effects_act_together_and_stay_out_of_the_public_scenario():
    assert not any(vars(hidden_effects(Scenario().hidden, 3)).values())
    entries = [at_strength(name, 5.0) for name in ALL if name != "plastic_set"]
    world = World(shipped_arm("follower"), Scenario().with_hidden(entries))
    world.object.move_surface(world.truth().tip_position_world_m[2] + 0.002)
    world.advance_to(0.2)
    assert np.isfinite(world.truth().joint_position_rad).all()
    world = Scenario(seed=7).with_hidden([at_strength(name, 10.0) for name in ALL])
    public = world.public_yaml()
    assert "hidden" not in public
    assert not [name for name in VOCABULARY - {*CONTACT_LAWS} if re.search(rf"\b{name}\b", public)]
    assert Scenario.load(parse_yaml(public, "public")) == Scenario(seed=7)


@pytest.mark.parametrize(
    ("hidden", "words"),
    [
        ("[{effect: coulomb_frictoin, joint: 2, coulomb_nm: 0.3}]", "mean 'coulomb_friction'. Valid: ad"),
        ("[{effect: coulomb_friction, coulomb_nm: 0.3}]", "joint: is missing"),
        ("[{effect: coulomb_friction, joint: 0, coulomb_nm: 0.3}]", "joint: .*greater than or equal to 1"),
        ("[{effect: coulomb_friction, joint: 1, torque: 0.3}]", "torque: is not known.*coulomb_nm, joint"),
        ("[{effect: stress_relaxation, stiffness_n_m: 5, time_s: 0}]", "time_s: "),
        ("[{effect: bias, channel: force, bias: 1}]", "channel: .*contact"),
        ("[{joint: 2}]", "a mapping with 'effect' and parameters. Valid: adhesion, armature"),
        ("[bias]", "hidden entry 1: a hidden effect is a mapping"),
    ],
)
def test_wrong_entry_is_refused_with_its_place_and_the_choices(hidden, words, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(f"seed: 1\nhidden: {hidden}\n")
    with pytest.raises(InputError, match=words) as caught:
        load_scenario(str(path))
    assert str(caught.value).startswith(f"{path} line 2, ")


@pytest.mark.parametrize("name", ["contact_offset", "plastic_set", "tool_compliance"])
def test_effects_of_geometry_need_a_force_law(name):
    with pytest.raises(InputError, match=f"'{name}' needs a force law"):
        load_scenario("engine").with_hidden([at_strength(name, 5.0)])
    friction = at_strength("coulomb_friction", 5.0)
    assert load_scenario("engine").with_hidden([friction]).hidden == (friction,)


def test_equal_seeds_draw_the_same_and_different_ones_all_effects():
    drawn = [draw_hidden(seed)[0] for seed in range(600)]
    assert drawn == [draw_hidden(seed)[0] for seed in range(600)]
    shown = {n for n, kind in IMPERFECTIONS.items() if set(kind.shows_in) & set(SCALE.channels)}
    assert {entry.name for entry in drawn} == shown
    assert VOCABULARY - shown == {
        "contact_offset",
        "tool_compliance",
        "backlash",
        "joint_elasticity",
        "sensor_gain",
    }
    assert np.mean([CONTACT in entry.channels for entry in drawn]) == pytest.approx(0.5, abs=0.08)


def test_strengths_are_drawn_evenly_on_a_logarithmic_scale():
    strengths = [
        draw_hidden(seed, CONTACT, effect="adhesion")[0].pull_off_n / SCALE.contact_noise_n
        for seed in range(400)
    ]
    assert min(strengths) >= WEAKEST
    assert max(strengths) <= STRONGEST
    assert np.median(strengths) == pytest.approx(np.sqrt(WEAKEST * STRONGEST), rel=0.15)


@given(st.integers(0, 10_000), st.sampled_from([None, *SCALE.channels]), st.sampled_from(["soft", "engine"]))
def test_drawn_effect_suits_its_world_and_channel(seed, channel, name):
    scenario = load_scenario(name)
    (entry,) = draw_hidden(seed, channel, scenario=scenario)
    assert hidden_effects([entry], 3)
    assert scenario.with_hidden([entry]).hidden == (entry,)
    assert channel is None or channel in entry.channels


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"channel": "joint_9"}, "channel 'joint_9'.*Valid: contact, joint_1, joint_2, joint_3"),
        ({"channel": "joint_3", "effect": "payload"}, "Valid: joint_1, joint_2"),
    ],
)
def test_unplottable_data_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        draw_hidden(1, **options)


@given(st.integers(1, 99))
def test_channels_and_joints_name_each_other(joint):
    assert joint_of(channel_of(joint)) == joint


@pytest.mark.parametrize("channel", ["contact", "joint_", "joint_0", "joint_x", "2"])
def test_channel_without_a_joint_is_refused(channel):
    with pytest.raises(InputError, match="is not a joint"):
        joint_of(channel)
