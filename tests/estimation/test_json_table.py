"""Tables in JSON: records, columns, rows, and lines of records."""

import json

import numpy as np
import pytest

from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import data_files
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from tests.files import saved

TIME_S = np.linspace(0.0, 2.0, 200)
DEPTH_M = 2e-3 * np.sin(np.pi * TIME_S / 2.0)
FORCE_N = 900.0 * DEPTH_M
NAMES = ["time_s", "displacement_m", "force_N"]
ROWS = np.column_stack([TIME_S, DEPTH_M, FORCE_N]).tolist()
RECORDS = [dict(zip(NAMES, row, strict=True)) for row in ROWS]
COLUMNS = dict(zip(NAMES, map(list, zip(*ROWS, strict=True)), strict=True))


@pytest.mark.parametrize(
    "content",
    [
        RECORDS,
        COLUMNS,
        {"names": NAMES, "data": ROWS, "rate": 100},
        {"meta": {"by": "me"}, "log": {"press": COLUMNS}},
        {"log": {"other": [], "loads": [{"at": "noon", "raw": RECORDS}]}},
    ],
    ids=["records", "columns", "rows", "deep inside", "in a list of one"],
)
def test_table_is_detected_in_each_layout(tmp_path, content):
    (channel,) = import_file(saved(tmp_path / "press.json", json.dumps(content))).channels
    np.testing.assert_allclose(channel.position, DEPTH_M)
    np.testing.assert_allclose(channel.effort, FORCE_N)


def test_records_may_be_lines_and_nested(tmp_path):
    path = tmp_path / "joint.jsonl"
    nested = [{"t": row[0], "joint": {"pos": row[1], "torque": [row[2], 1.0]}} for row in ROWS]
    path.write_text("\n".join(map(json.dumps, nested)))
    table = read_table(path)
    assert table.names == ("t", "joint.pos", "joint.torque.0", "joint.torque.1")
    np.testing.assert_allclose(table.numbers("joint.torque.0"), FORCE_N)


def test_unnamed_columns_are_called_by_their_places(tmp_path):
    path = saved(tmp_path / "bare.json", json.dumps({"data": ROWS, "dt": 0.01, "time units": "s"}))
    table = read_table(path)
    assert (table.names, table.notes) == (("column 1", "column 2", "column 3"), ("no names of columns",))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "is not valid JSON"),
        ('{"a": 1}', "holds no table"),
        ("[]", "no table"),
        ('{"a": [1, 2, 3], "force_N": [1, 2, 3], "force_N": [4, 5, 6]}', "the key 'force_N' appears twice"),
        ('{"a": 1}\n\n{"a": 2}\n{"a": ', "is not valid JSON: line 4: "),
    ],
)
def test_file_without_a_table_is_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_table(saved(tmp_path / "a.json", text))


def test_description_in_a_folder_is_no_data(tmp_path):
    (tmp_path / "meta.json").write_text(json.dumps(RECORDS))
    (tmp_path / "a.csv").write_text("time_s,displacement_m,force_N\n0,0,0\n")
    assert data_files(tmp_path) == [tmp_path / "a.csv"]


def test_first_row_may_name_the_columns_and_lists_are_skipped(tmp_path):
    path = saved(tmp_path / "a.json", json.dumps([NAMES, *ROWS]))
    np.testing.assert_allclose(import_file(path).channels[0].effort, FORCE_N)
    path = tmp_path / "a.json"
    path.write_text(json.dumps(COLUMNS | {"spectrum": [0.0, *([[1.0, 2.0]] * (len(ROWS) - 1))]}))
    assert read_table(path).names == tuple(NAMES)
    path = saved(tmp_path / "a.json", json.dumps(COLUMNS | {"temperature": [20.0, 20.5, 21.0]}))
    assert read_table(path).notes == ("columns of other lengths left out: temperature",)


def test_true_among_numbers_is_refused(tmp_path):
    """A column of truths alone stays one, such as a flag of the contact."""
    path = tmp_path / "press.json"
    table = dict(COLUMNS)
    table["force_N"] = [*table["force_N"][:7], True, *table["force_N"][8:]]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match="row 8, column 'force_N': 'true' is not a finite number"):
        import_file(path)


def times_and_press(run):
    t = np.arange(60) * 0.01 + run
    return {"time_s": t.tolist(), "displacement_mm": (3.0 * np.sin(3.0 * t)).tolist(), "force_N": t.tolist()}


def as_records(columns):
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


@pytest.mark.parametrize(
    ("content", "labels"),
    [
        ([times_and_press(0), times_and_press(1)], ["0", "1"]),
        ({"slow": times_and_press(0), "fast": times_and_press(1)}, ["slow", "fast"]),
        ({"runs": [{"name": "a", "data": times_and_press(run)} for run in range(3)]}, ["0", "1", "2"]),
        ([{"speed": 3.0, "samples": as_records(times_and_press(run))} for run in range(2)], ["0", "1"]),
    ],
)
def test_parts_with_their_own_clocks_are_runs(tmp_path, content, labels):
    imported = import_file(saved(tmp_path / "runs.json", json.dumps(content)))
    assert list(imported.run_labels.values()) == labels
    (channel,) = imported.channels
    np.testing.assert_allclose(
        channel.effort, np.concatenate([times_and_press(n)["force_N"] for n, _ in enumerate(labels)])
    )


@pytest.mark.parametrize("by_record", [True, False])
def test_matrix_beside_a_clock_gives_its_columns(tmp_path, by_record):
    t = np.arange(200) * 0.01
    q = np.column_stack([np.sin(t), np.cos(t)])
    columns = {"time_s": t.tolist(), "position_rad": q.tolist(), "torque_Nm": (2.0 * q).tolist()}
    path = saved(tmp_path / "arm.json", json.dumps(as_records(columns) if by_record else columns))
    channels = import_file(path).channels
    np.testing.assert_allclose([channel.position for channel in channels], q.T)
