"""Robot file: errors with place, value and remedy."""

import copy
import re

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import RobotFile, load_robot_file, parse_robot_file
from tests.mock_robot import ROBOT_YAML, mock_robot_file, write_mock_files

VALID = yaml.safe_load(ROBOT_YAML)


def changed(**changes):
    """The valid file's text with some lines replaced; `key=None` drops a line."""
    lines = ROBOT_YAML.splitlines()
    for key, value in changes.items():
        at = next(i for i, line in enumerate(lines) if line.strip().startswith(f"{key}:"))
        indent = re.match(" *", lines[at])[0]
        lines[at] = "" if value is None else f"{indent}{key}: {value}"
    return "\n".join(lines)


def test_info_matches_the_file(tmp_path):
    robot_file = load_robot_file(write_mock_files(tmp_path))
    assert robot_file.name == "mock"
    assert robot_file.joint_count == 3
    assert robot_file.home_rad == (-1.275, 1.391, 1.455)
    assert robot_file.limits.force_n == 30.0
    assert robot_file.encoder.bus == "world"
    assert robot_file.urdf_path == tmp_path / "mock.urdf"
    assert robot_file.text == ROBOT_YAML


def test_driver_settings_are_passed_on_unread_and_the_file_is_immutable():
    robot_file = parse_robot_file(
        changed(force="{driver: mock_force, bus: world, gain: 2, unit: N}"), "m.yaml"
    )
    assert robot_file.force.settings == {"gain": 2, "unit": "N"}
    turned = parse_robot_file(changed(sensor_axis_tip="[0, 3, -4]"), "m.yaml")
    assert turned.sensor_axis_tip == (0.0, 0.6, -0.8)
    with pytest.raises(ValueError, match="frozen"):
        mock_robot_file().name = "other"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": None}, "m.yaml, name: is missing"),
        (
            {"name": "'two words'"},
            "name: give 1 to 64 letters, digits, _ . or -, starting with a letter or digit",
        ),
        ({"tip_frame": "5"}, " line 3, tip_frame: input should be a valid string (is 5)"),
        ({"sensor_axis_tip": "[0, 0, 0]"}, " line 4, sensor_axis_tip: has no direction"),
        ({"control_rate_hz": "0"}, "control_rate_hz: input should be greater than or equal to 20 (is 0)"),
        ({"control_rate_hz": "true"}, " line 5, control_rate_hz: expected a number (is True)"),
        ({"control_rate_hz": "'1000'"}, " line 5, control_rate_hz: expected a number (is '1000')"),
        ({"encoder": "{driver: mock_encoder, bus: wrold}"}, "encoder.bus: is not in 'buses'. Valid: world"),
        ({"encoder": "{bus: world}"}, " line 8, encoder.driver: is missing"),
        ({"home_rad": "[0, 0]"}, "limits.torque_nm: has 3 values, but home_rad has 2"),
        ({"home_rad": "[-1, 1, 9]"}, "entry 3: joint 3 is outside its position limits -2.6 to 2.8 (is 9.0)"),
        ({"torque_nm": "[1, 2, .nan]"}, "limits.torque_nm entry 3: input should be a finite number"),
        ({"torque_nm": "[1, 2, -3]"}, " line 13, limits.torque_nm entry 3: input should be greater than 0"),
        ({"torque_nm": "[1, 2, 1e300]"}, "limits.torque_nm entry 3: input should be less than or equal to 1"),
        ({"torque_rate_nm_s": "[1, 2, 1e8]"}, "torque_rate_nm_s entry 3: input should be less than"),
        ({"position_max_rad": "[1e300, 3, 3]"}, "position_max_rad entry 1: input should be less than"),
        ({"position_min_rad": "[-101, -3, -3]"}, "position_min_rad entry 1: input should be greater than"),
        ({"velocity_rad_s": "[1, 1e300, 1]"}, "velocity_rad_s entry 2: input should be less than"),
        ({"tracking_rad": "[1, 1, 7]"}, "tracking_rad entry 3: input should be less than"),
        ({"force_n": "1e9"}, "limits.force_n: input should be less than"),
        ({"force_age_s": "1e308"}, "limits.force_age_s: input should be less than"),
        ({"torque_rate_nm_s": "[1, 2]"}, "limits: torque_rate_nm_s has 2 values, but torque_nm has 3"),
        ({"position_min_rad": "[1, 0, 0]"}, "limits: position_min_rad 1.0 is not below position_max_rad 0.4"),
        ({"position_min_rad": "[-2.6, 2.6, -2.6]"}, "limits: position_min_rad 2.6 is not below"),
        (
            {"home_rad": "[-1, 1, 1]\nrotor_inertia_kg_m2: [0.1, 300, 0.1]"},
            "rotor_inertia_kg_m2 entry 2: give 0 to 15 kg m2; with a larger inertia, the torque limit",
        ),
        ({"force_n": None}, " line 12, limits.force_n: is missing"),
        ({"safe_state": "{damping_nms_rad: [1, 1], stop_time_s: 1}"}, "safe_state.damping_nms_rad: has 2"),
        ({"safe_state": "{damping_nms_rad: [1, 1, 1], stop_time_s: 60}"}, "safe_state.stop_time_s: input"),
    ],
)
def test_invalid_file_is_refused_with_its_place(changes, message):
    with pytest.raises(InputError) as caught:
        parse_robot_file(changed(**changes), "m.yaml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("m.yaml")
    assert "more)" not in str(caught.value)


def test_arm_may_rest_at_its_limits():
    robot_file = parse_robot_file(changed(home_rad="[-2.6, 2.6, 0]"), "m.yaml")
    assert robot_file.home_rad == (-2.6, 2.6, 0.0)


def test_unknown_key_gets_a_hint_its_line_and_the_number_of_further_errors():
    with pytest.raises(InputError) as caught:
        parse_robot_file(ROBOT_YAML.replace("force_n: 30", "force_N: 30"), "m.yaml")
    said = "m.yaml line 18, limits.force_N: is not known; did you mean 'force_n'? Valid: "
    assert str(caught.value).startswith(said)
    with pytest.raises(InputError, match=r"\(and 2 more\)$"):
        parse_robot_file(changed(name=None, tip_frame=None, urdf=None), "m.yaml")


@pytest.mark.parametrize("key", ["urdf", "dh"])
def test_named_files_must_exist(tmp_path, key):
    path = write_mock_files(tmp_path)
    text = re.sub("^urdf:.*$", "", ROBOT_YAML, flags=re.MULTILINE) if key == "urdf" else ROBOT_YAML
    path.write_text(text + f"\n{key}: absent.file\n")
    with pytest.raises(InputError, match=rf"mock\.yaml line \d+, {key}: no such file: .*absent\.file"):
        load_robot_file(path)


@pytest.mark.parametrize("second", ["line", "alias"])
def test_one_serial_port_is_not_two_buses(tmp_path, second):
    path = write_mock_files(tmp_path)
    (tmp_path / "line").touch()
    (tmp_path / "alias").symlink_to(tmp_path / "line")
    own = f"  one: {{driver: serial_line, port: {tmp_path}/line}}\n"
    two = f"  two: {{driver: serial_line, port: {tmp_path}/{second}}}\n"
    begin = ROBOT_YAML.index("buses:\n") + len("buses:\n")
    path.write_text(ROBOT_YAML[:begin] + own + ROBOT_YAML[begin:])
    assert "one" in load_robot_file(path).buses
    path.write_text(ROBOT_YAML[:begin] + own + two + ROBOT_YAML[begin:])
    with pytest.raises(InputError, match=r"mock\.yaml line \d+, buses\.two\.port: is also the port of 'one'"):
        load_robot_file(path)


def test_saved_robot_file_is_read_without_its_referenced_files():
    assert parse_robot_file(ROBOT_YAML, "gone/mock.yaml").urdf_path.name == "mock.urdf"


def key_paths(value, path=()):
    """Every place in the valid file."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from key_paths(inner, (*path, key))


PLACES = [path for path in key_paths(VALID) if path]
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


def put(place, change):
    """A copy of the valid file's data with `change(container, key)` done at `place`."""
    data = copy.deepcopy(VALID)
    container = data
    for key in place[:-1]:
        container = container[key]
    change(container, place[-1])
    return data


def check(text):
    """The error of a robot file (one line that names the file and a place in it), or None if it is valid."""
    try:
        robot_file = parse_robot_file(text, "m.yaml")
    except InputError as error:
        message = str(error)
    else:
        assert isinstance(robot_file, RobotFile)
        return None
    assert "\n" not in message
    assert re.match(r"m\.yaml( line \d+)?[,:] \S", message), message
    return message


@given(st.sampled_from(PLACES), VALUES)
def test_any_value_anywhere_gives_a_robot_or_an_input_error(place, value):
    def replace(container, key):
        container[key] = value

    message = check(yaml.safe_dump(put(place, replace), allow_unicode=True))
    if message:
        assert re.match(r"m\.yaml( line \d+, \S+( entry \d+)*)?: \S", message), message


@pytest.mark.parametrize("place", PLACES, ids=str)
def test_missing_part_is_named(place):
    def drop(container, key):
        del container[key]

    message = check(yaml.safe_dump(put(place, drop)))
    if isinstance(place[-1], str) and message and "is missing" in message:
        assert f"{'.'.join(map(str, place))}: is missing" in message


@given(st.sampled_from(PLACES), st.text(max_size=12), VALUES)
def test_extra_key_gives_a_robot_or_an_input_error(place, key, value):
    def add(container, _):
        if isinstance(container, dict):
            container[key] = value
        else:
            container.append(value)

    check(yaml.safe_dump(put(place, add), allow_unicode=True))


@given(st.integers(0, len(ROBOT_YAML)), st.integers(0, 40), st.text(max_size=10))
def test_damaged_text_gives_a_robot_or_an_input_error(start, length, inserted):
    check(ROBOT_YAML[:start] + inserted + ROBOT_YAML[start + length :])
