import pytest
import yaml

from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file
from tests.mock_robot import write_mock_files
from tests.robot_io.calibration.parts import KINDS, calibration_of, load_calibration, parse_calibration


@pytest.fixture
def robot(tmp_path):
    return load_robot_file(write_mock_files(tmp_path))


@pytest.mark.parametrize("kind", KINDS)
def test_written_data_are_read_back(robot, tmp_path, kind):
    calibration = calibration_of(kind, robot)
    path = tmp_path / "c.yaml"
    path.write_text(calibration.to_yaml())
    assert load_calibration(path) == calibration


def changed(robot, kind, change):
    data = yaml.safe_load(calibration_of(kind, robot).to_yaml())
    change(data)
    return yaml.safe_dump(data)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("force", lambda d: d.update(kind="forse"), ("kind", "force, encoder, torque, gravity", "'forse'")),
        ("force", lambda d: d.pop("kind"), ("kind", "missing")),
        ("force", lambda d: d["values"].update(gain=1), ("values.gain", "is not known", "curvature")),
        ("force", lambda d: d["values"]["zero"].update(unit="lbf"), ("values.zero.unit", "'N'", "lbf")),
        ("force", lambda d: d["values"]["zero"].update(value=float("nan")), ("values.zero",)),
        ("force", lambda d: d["values"]["scale"].update(value=-1.0), ("values.scale", "positive")),
        ("force", lambda d: d["values"]["scale"].update(value=50.0), ("values.scale", "0.5 and 2")),
        ("force", lambda d: d["values"]["scale"].update(value=0.11), ("values.scale", "0.5", "setting")),
        ("force", lambda d: d["values"]["scale"].update(value=True), ("scale",)),
        ("force", lambda d: d.update(valid_until_utc="2020-01-01T00:00:00+00:00"), ("valid_until_utc",)),
        ("force", lambda d: d.update(made_utc="2026-11-20T08:00:00"), ("made_utc", "timezone")),
        ("force", lambda d: d.update(made_utc=17), ("made_utc", "date")),
        ("force", lambda d: d.update(palpate_calibration=2), ("palpate_calibration",)),
        ("force", lambda d: d["raw_data"].update(sha256="x"), ("raw_data.sha256",)),
        ("encoder", lambda d: d["values"]["offset"].update(value=[4.0, 0, 0]), ("values.offset", "4")),
        ("encoder", lambda d: d["values"]["offset"].update(std_err=[0.1]), ("offset", "3 values but 1")),
        (
            "torque",
            lambda d: d["values"]["gain"].update(value=[1, 0.0, 1]),
            ("values.gain", "0.2 and 5", "joint 2"),
        ),
        ("torque", lambda d: d.pop("urdf_sha256"), ("urdf_sha256", "missing")),
        ("gravity", lambda d: d["values"]["pitch"].update(value=3.0), ("values.pitch", "3")),
        ("gravity", lambda d: d["values"].clear(), ("pitch or roll",)),
    ],
)
def test_invalid_setting_is_named(robot, kind, change, words):
    with pytest.raises(InputError) as caught:
        parse_calibration(changed(robot, kind, change), "c.yaml")
    text = str(caught.value)
    assert "c.yaml" in text
    assert "\n" not in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("kind", "change", "line"),
    [
        ("force", lambda d: d["values"]["scale"].update(value=50.0), "    value: 50.0"),
        ("force", lambda d: d["values"]["zero"].update(unit="lbf"), "    unit: lbf"),
        ("force", lambda d: d.update(reading_unit="N m?"), "reading_unit: N m?"),
        ("torque", lambda d: d["values"]["gain"].update(value=[1, 0.0, 1]), "    value:"),
        ("gravity", lambda d: d["values"].clear(), "values: {}"),
    ],
)
def test_error_line_is_that_of_the_wrong_key(robot, kind, change, line):
    text = changed(robot, kind, change)
    with pytest.raises(InputError) as caught:
        parse_calibration(text, "c.yaml")
    number = int(str(caught.value).removeprefix("c.yaml line ").partition(",")[0])
    assert text.splitlines()[number - 1] == line


def test_missing_columns_and_invalid_units_are_reported(robot):
    with pytest.raises(InputError, match=r"^c\.yaml, urdf_sha256: is missing$"):
        parse_calibration(changed(robot, "torque", lambda d: d.pop("urdf_sha256")), "c.yaml")
    with pytest.raises(InputError, match=r"give 1 to 20 letters, .* \(is 'N m\?'\)"):
        parse_calibration(changed(robot, "force", lambda d: d.update(reading_unit="N m?")), "c.yaml")


def test_oversized_or_irregular_file_is_refused(robot, tmp_path):
    text = calibration_of("force", robot).to_yaml()
    path = tmp_path / "c.yaml"
    path.write_text(text + "#" * 70_000)
    with pytest.raises(InputError, match="larger than"):
        load_calibration(path)
    with pytest.raises(InputError, match="tag"):
        parse_calibration(text + "x: !!python/object/apply:os.system [ls]\n", "c.yaml")
