"""Scenario files: content, errors, and one form for every contact law."""

import inspect
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, parse_yaml
from palpate.sim_backend.contact_laws import CONTACT_LAWS, parse_contact_law
from palpate.sim_backend.scenario import Scenario, load_scenario, shipped_scenarios

SHIPPED = ["default", "engine", "hunt_crossley", "paper", "soft", "stiff"]
LAWS = {
    "engine": {"stiffness_n_m": 500.0, "damping_n_s_m": 20.0},
    "hunt_crossley": {"stiffness": 7000.0, "damping": 4000.0, "exponent": 1.5},
    "kelvin_voigt": {"stiffness_n_m": 500.0, "damping_n_s_m": 20.0},
}


def test_documented_scenarios_are_shipped():
    assert shipped_scenarios() == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenario_survives_a_round_trip(name):
    scenario = load_scenario(name)
    assert scenario.description
    assert Scenario.load(parse_yaml(scenario.to_yaml(), "copy")) == scenario
    assert load_scenario(scenario) is scenario


def test_default_file_states_every_default_and_named_objects_match():
    default = load_scenario("default")
    assert default.model_copy(update={"description": ""}) == Scenario()
    stated = load_scenario("default").model_dump(exclude_unset=True)
    assert stated.keys() == default.model_dump().keys()
    assert {key: part.keys() for key, part in stated["sensors"].items()} == {
        key: part.keys() for key, part in default.model_dump()["sensors"].items()
    }
    law = {"stiffness_n_m": 500.0, "damping_n_s_m": 100.0, "sticky": False}
    assert load_scenario("paper").object.law.model_dump() == law
    assert load_scenario("stiff").object.law.stiffness_n_m == 7100.0


def test_scenario_path_is_relative_to_the_robot_file(tmp_path):
    (tmp_path / "mine.yaml").write_text("seed: 5\nsensors: {force: {noise_std_n: 0.5}}\n")
    scenario = load_scenario("mine.yaml", tmp_path)
    assert (scenario.seed, scenario.sensors.force.noise_std_n) == (5, 0.5)
    assert scenario.object == Scenario().object


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("object: {law: {name: kelvin_voight}}", "did you mean 'kelvin_voigt'. Valid: engine, hunt_cr"),
        ("seed: 1\nobject:\n law: {name: kelvin_voigt, stiffness_n_m: -1, damping_n_s_m: 0}", "line 3, obj"),
        ("object: {law: {name: kelvin_voigt, damping_n_s_m: 0}}", "stiffness_n_m: is missing"),
        ("object: {law: {stiffness_n_m: 3}}", "with 'name' and parameters. Valid: engine, hunt_crossley"),
        ("sensors:\n  forse: {}", "line 2, sensors.forse: is not known; did you mean 'force'"),
        ("sensors: {force: {delay_s: 1e308}}", "sensors.force.delay_s: .*less than or equal to 10"),
        ("sensors: {encoder: {velocity: {source: gps}}}", "'difference' or 'tachometer'"),
        ("sensors: {torque: {phase: 1}}", "less than 1"),
        ("physics: {rate_hz: true}", "physics.rate_hz: expected a number"),
        ("seed: 1.5", "seed: "),
    ],
)
def test_wrong_scenario_is_refused_with_its_place_and_the_choices(text, words, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_scenario(str(path))
    assert str(caught.value).startswith(f"{path} line ")
    assert "\n" not in str(caught.value)


def test_unknown_scenario_is_refused_with_the_shipped_ones():
    with pytest.raises(InputError, match=r"no scenario 'defualt'.*default, engine, hunt_crossley"):
        load_scenario("defualt")


@pytest.mark.parametrize("source", [3, None, ["default"]])
def test_invalid_scenario_is_refused(source):
    with pytest.raises(InputError, match="a name, a path or a mapping"):
        load_scenario(source)


JSON_LIKE = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from([*LAWS, "name", "law"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from([*Scenario.model_fields, "x"]), JSON_LIKE, max_size=4))
def test_any_mapping_makes_a_scenario_or_one_clear_line(mapping):
    try:
        said = load_scenario(mapping).to_yaml()
    except InputError as error:
        said = f"error: {error}"
    assert said.startswith("error: ") == ("\n" not in said)


def test_every_law_has_an_example_here():
    assert sorted(CONTACT_LAWS) == sorted(LAWS)


@pytest.mark.parametrize("name", sorted(LAWS))
class TestEveryLaw:
    def test_law_is_documented_and_round_trips(self, name):
        law_type = CONTACT_LAWS[name]
        assert issubclass(law_type, FileModel)
        source = inspect.getsource(law_type)
        assert all(re.search(rf"    {field}: .*#", source) for field in law_type.model_fields)
        law = parse_contact_law({"name": name, **LAWS[name]})
        assert parse_contact_law(law.describe()) == law
        law = parse_contact_law({"name": name, **LAWS[name]})
        assert [law.force_n(depth, rate) for depth in (-0.01, 0.0) for rate in (-1.0, 1.0)] == [0.0] * 4

    @given(st.floats(1e-6, 0.1), st.floats(-1.0, 1.0), st.floats(1e-6, 0.1), st.floats(0.0, 1.0))
    def test_law_pushes_more_the_deeper_and_faster_and_never_pulls(self, name, depth, rate, deeper, faster):
        law = parse_contact_law({"name": name, **LAWS[name]})
        force = law.force_n(depth, rate)
        assert force >= 0.0
        assert math.isfinite(force)
        assert law.force_n(depth, rate + faster) >= force
        if rate >= 0:
            assert law.force_n(depth + deeper, rate) > force
