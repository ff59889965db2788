"""Recipes of public recordings: conversion, split, ladder and score, on files made here."""

import bz2
import csv
import gzip
import hashlib
import io
import json
import struct
import subprocess
import zipfile
from functools import cache

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from benchmarks.measured.convert import (
    RECIPES,
    SPLITS,
    Origin,
    convert,
    load_recipe,
    read_bag,
    read_json,
    split_of,
)
from benchmarks.measured.ladder import TERMS, Ladder, load, thin
from benchmarks.measured.score import score, summary
from palpate.estimation.effects import EFFECTS
from palpate.estimation.kinds import Kind
from palpate.estimation.models import MODELS

KINDS = {str(kind) for kind in Kind if kind is not Kind.OTHER}


@cache
def recipes_by_name():
    return {path.stem: load_recipe(path.stem) for path in sorted(RECIPES.glob("*.yaml"))}


def test_recipe_names_only_kinds_effects_and_models_that_exist():
    for name, recipe in recipes_by_name().items():
        expected = recipe["expected"]
        assert recipe["name"] == name
        assert len(recipe["origin"]["commit"]) == 40, name
        assert expected["kinds"] or "adequate" in expected["verdicts"], name
        assert set(expected["kinds"]) <= set(expected["groups"]) <= KINDS, name
        assert {effect for group in expected["groups"].values() for effect in group} <= set(EFFECTS), name
        assert expected["form"] in {"known", "unknown", "either"}, name
        assert recipe["model"] in MODELS, name
        assert "columns" in recipe or "raw" in recipe, name
        if "ladder" in recipe:
            assert {step["kind"] for step in recipe["ladder"]["steps"]} <= KINDS, name


def test_split_follows_from_the_digest_unless_the_recipe_states_it():
    for name in ("a", "b", "c", "d", "e"):
        digit = hashlib.sha256(name.encode()).hexdigest()[-1]
        assert split_of({"name": name}) == ("develop" if digit in "02468ace" else "held_out")
        assert split_of({"name": name, "split": "held_out"}) == "held_out"
    assert {split_of(recipe) for recipe in recipes_by_name().values()} == set(SPLITS)


SEMICOLONS = {"format": "text", "files": ["*.txt"], "delimiter": ";"}
TRIALS = {  # columns of what `write_trials` writes
    "time_s": {"sum": {"Zeit": 1e-3}},
    "displacement_m": {"sum": {"1": 1e-3}, "zero": 1},
    "force_N": {"sum": {"2": 2.0, "1": 1.0}, "offset": 5.0},
}


def recipe_of(columns, read, **more):
    """A recipe; a column that is a name is taken from the column of that name."""
    given = {name: {"sum": {of: 1.0}} if isinstance(of, str) else of for name, of in columns.items()}
    return {"read": read, "columns": given, **more}


def converted(folder, columns, *, more=None, **read):
    """Columns of the table that a recipe makes of the files in a folder."""
    convert(recipe_of(columns, read, **more or {}), Origin(folder, ""), folder / "out")
    with gzip.open(folder / "out" / "import.csv.gz", "rt") as file:
        rows = [{key: float(cell) for key, cell in row.items()} for row in csv.DictReader(file)]
    return {key: [row[key] for row in rows] for key in rows[0]}


def trials(folder, **read):
    """The table of two trials with decimal commas, below a line of names."""
    for number in (1, 2):
        lines = ["Zeit;Weg;Kraft", *(f"{10 * i},0;{number + i},5;{i}" for i in range(6)), "end of test"]
        (folder / f"trial{number}.txt").write_text("\n".join(lines))
    return converted(folder, TRIALS, **SEMICOLONS, skip=1, decimal=",", **read)


def test_conversion_scales_zeroes_and_numbers_runs(tmp_path):
    table = trials(tmp_path)
    assert table["run"] == [0] * 6 + [1] * 6
    np.testing.assert_allclose(table["time_s"][:6], 0.01 * np.arange(6))
    np.testing.assert_allclose(table["displacement_m"][6:], 1e-3 * np.arange(6), atol=1e-12)
    np.testing.assert_allclose(table["force_N"][:6], 2 * np.arange(6) + np.arange(6) + 6.5)


def test_conversion_averages_blocks_and_cuts_pieces_or_keeps_spaced_rows(tmp_path):
    table = trials(tmp_path, every=2, pieces=3)
    assert table["run"] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(table["time_s"][:3], [0.005, 0.025, 0.045])
    assert trials(tmp_path, thin=0.025)["time_s"] == [0.0, 0.03, 0.0, 0.03]


def test_conversion_unwraps_an_encoder_that_restarts(tmp_path):
    turned = np.linspace(0.0, 60.0, 31) - 5.0
    wrapped = (turned + 12.5) % 25.0 - 12.5
    np.savez(tmp_path / "a.npz", time=np.arange(31.0), q=wrapped)
    columns = {"time_s": "time", "position_rad": {"sum": {"q": 2.0}, "unwrap": 50.0}, "raw_rad": "q"}
    table = converted(tmp_path, columns, format="numpy", files=["a.npz"])
    np.testing.assert_allclose(table["position_rad"], 2.0 * turned, atol=1e-6)
    np.testing.assert_allclose(table["raw_rad"], wrapped, atol=1e-6)


def test_trials_side_by_side_have_the_columns_that_the_recipe_names(tmp_path):
    (tmp_path / "a.txt").write_text("t;F;x;t;F;x\n0;1;2;0;10;20\n1;3;4;1;30;40\n2;5;6;;;\n")
    read = SEMICOLONS | {"format": "trials", "names": ["t", "F", "x"], "skip": 1}
    table = converted(tmp_path, {"time_s": "t", "force_N": "F", "x_m": "x"}, **read)
    assert table["run"] == [0, 0, 0, 1, 1]
    assert table["force_N"] == [1, 3, 5, 10, 30]
    assert table["x_m"] == [2, 4, 6, 20, 40]


def test_packed_text_is_unpacked(tmp_path):
    (tmp_path / "packed.txt.gz").write_bytes(gzip.compress(b"1;2\n"))
    assert Origin(tmp_path, "").read("packed.txt.gz") == b"1;2\n"


def test_vectors_and_columns_of_a_numpy_archive_are_read(tmp_path):
    np.savez(tmp_path / "a.npz", time=np.arange(4.0), q=np.arange(12.0).reshape(4, 3), name="x")
    columns = {"time_s": "time", "position_rad": "q.2"}
    assert converted(tmp_path, columns, format="numpy", files=["a.npz"])["position_rad"] == [2, 5, 8, 11]


def test_tables_of_an_archive_that_match_are_runs_sorted_by_name(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, force in (("soil/2.TXT", 5), ("soil/1.TXT", 3), ("notes.TXT", 9)):
            archive.writestr(name, f"Plate: 4 cm\nF,x\n0,0\n{force},1\n")
    read = {"format": "zip", "files": ["a.zip"], "members": "soil/*.TXT", "delimiter": ",", "skip": 2}
    table = converted(tmp_path, {"time_s": {"step": 0.1}, "force_N": "F", "x_m": "x"}, **read)
    assert (table["run"], table["force_N"]) == ([0, 0, 1, 1], [0, 3, 0, 5])


def test_items_of_a_matlab_cell_are_named_by_their_number(tmp_path):
    cell = np.empty((1, 2), dtype=object)
    cell[0, 0], cell[0, 1] = ({"t": np.arange(3.0), "q": factor * np.arange(3.0)} for factor in (1, 2))
    savemat(tmp_path / "a.mat", {"train": cell})
    chain = {"t": ["train.0.t", "train.1.t"], "q": ["train.0.q", "train.1.q"]}
    read = {"format": "matlab", "files": ["a.mat"], "chain": chain, "restarts": "t"}
    table = converted(tmp_path, {"time_s": "t", "position_rad": "q"}, **read)
    assert (table["run"], table["position_rad"]) == ([0, 0, 0, 1, 1, 1], [0, 1, 2, 0, 2, 4])


def nameless(value):
    """A MATLAB file that holds one variable without a name."""
    file = io.BytesIO()
    savemat(file, {"q": value})
    return file.getvalue().replace(b"\1\0\1\0q\0\0\0", b"\1\0\0\0\0\0\0\0", 1)


def test_what_objects_of_a_matlab_file_hold_is_named_by_its_number(tmp_path):
    held = np.empty((3, 1), dtype=object)
    held[0, 0], held[1, 0], held[2, 0] = np.arange(9.0), "s", np.array([[1.0, 5.0], [2.0, 6.0], [4.0, 7.0]])
    inner = nameless({"MCOS": held})
    hidden = np.frombuffer(inner[124:128] + bytes(4) + inner[128:], np.uint8)
    other = io.BytesIO()
    savemat(other, {"h": np.array([0.5, 0.0])})
    (tmp_path / "a.mat").write_bytes(nameless(hidden) + other.getvalue()[128:])
    columns = {"time_s": {"step": 0.5}, "position_rad": "objects.2", "torque_Nm": "objects.2.1"}
    table = converted(tmp_path, columns, format="matlab", files=["a.mat"])
    assert (table["time_s"], table["position_rad"]) == ([0, 0.5, 1], [1, 2, 4])
    assert table["torque_Nm"] == [5, 6, 7]


def test_tables_packed_in_one_archive_may_have_another_format(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("bars/a.json", json.dumps({"brand": "a", "strain": [0, 1], "stress": [2, 4]}))
        archive.writestr("bars/b.json", json.dumps({"brand": "b", "strain": [0, 2], "stress": [1, 3]}))
    read = {"format": "zip", "packed": "json", "files": ["a.zip"], "members": "bars/*.json"}
    table = converted(tmp_path, {"time_s": "strain", "force_N": "stress"}, **read)
    assert (table["time_s"], table["force_N"]) == ([0, 1, 0, 2], [2, 4, 1, 3])


def tdms_text(text):
    return struct.pack("<I", len(text)) + text.encode()


def tdms_segment(contents, objects, values):
    """Segment of a TDMS file of double precision; `objects`: paths, and their number of values."""
    listed = struct.pack("<I", len(objects)) if objects else b""
    for path, count in objects.items():
        index = struct.pack("<IIIQ", 20, 10, 1, count) if count else b"\xff" * 4
        listed += tdms_text(path) + index
        listed += struct.pack("<I", 1) + tdms_text("name") + struct.pack("<I", 32) + tdms_text("any")
    numbers = np.array(values).tobytes()
    lengths = struct.pack("<QQ", len(listed) + len(numbers), len(listed))
    return b"TDSm" + struct.pack("<II", contents, 4713) + lengths + listed + numbers


def test_channels_of_a_tdms_file_are_columns_of_a_table_for_each_group(tmp_path):
    new_list, same_list, no_list = 2 + 4 + 8, 2 + 8, 8
    first = {"/": 0, "/'a'": 0, "/'a'/'t'": 2, "/'a'/'load'": 2}
    third = {"/'b'": 0, "/'b'/'t'": 1, "/'b'/'load'": 1}
    content = tdms_segment(new_list, first, [0.0, 1.0, 5.0, 6.0])
    content += tdms_segment(no_list, {}, [2.0, 3.0, 7.0, 8.0])
    content += tdms_segment(same_list, {"/'a'/'load'": 1, "/'a'/'t'": 1}, [4.0, 9.0])
    content += tdms_segment(new_list, third, [0.0, -1.0])
    (tmp_path / "log.tdms").write_bytes(content)
    columns = {"time_s": "t", "force_N": "load"}
    table = converted(tmp_path, columns, format="tdms", files=["log.tdms"])
    assert (table["time_s"], table["force_N"]) == ([0, 1, 2, 3, 4, 0], [5, 6, 7, 8, 9, -1])
    assert table["run"] == [0, 0, 0, 0, 0, 1]
    table = converted(tmp_path, columns, format="tdms", files=["log.tdms"], groups="b")
    assert (table["time_s"], table["force_N"]) == ([0], [-1])


def test_lists_in_quoted_cells_are_columns_by_their_place(tmp_path):
    (tmp_path / "a.csv").write_text('t,q,note\n0.5,"[1.0, 2.0]",x\n1,"[3.0, 4.0]",x\n')
    table = converted(tmp_path, {"time_s": "t", "q_rad": "q.1"}, format="quoted", files=["a.csv"])
    assert (table["time_s"], table["q_rad"]) == ([0.5, 1], [2, 4])


def test_curves_of_a_nid_file_are_runs_in_units_of_its_ranges(tmp_path):
    channels = {
        "Spec forward": [[-(2**15), 0, 2**14], [0, 2**14, 0]],
        "Spec backward": [[0, 0, 0], [0, 0, 0]],
    }
    head = "".join(
        f"[DataSet-1:{i}]\nPoints=3\nLines=2\nSaveBits=16\nFrame={frame}\nDim2Name=Deflection\n"
        "Dim2Min=-1\nDim2Range=4\nLineDim1Points=2\n"
        for i, frame in enumerate(channels)
    )
    numbers = np.array(list(channels.values()), "<i2").tobytes()
    (tmp_path / "a.nid").write_bytes(f"[DataSet]\nVersion=2\n{head}#!".encode() + numbers)
    columns = {"time_s": {"step": 0.1}, "force_N": "Spec forward.Deflection"}
    table = converted(tmp_path, columns, format="nid", files=["a.nid"], frames=["Spec forward"])
    assert (table["run"], table["force_N"]) == ([0, 0, 0, 1, 1], [-1, 1, 2, 1, 2])


def test_numbers_of_one_type_are_read_from_where_they_begin(tmp_path):
    (tmp_path / "a.000").write_bytes(b"head" + np.array([300, -2, 5, 9], dtype=">i2").tobytes())
    read = {"format": "binary", "type": ">i2", "skip": 6, "count": 2, "files": ["a.000"]}
    table = converted(tmp_path, {"time_s": {"step": 1.0}, "force_N": {"sum": {"0": 0.5}}}, **read)
    assert (table["time_s"], table["force_N"]) == ([0, 1], [-1, 2.5])


def test_log_of_records_has_a_column_for_each_number():
    log = b'{"motor": "a", "entries": [{"t": 0, "q": 0.5, "goal": null}, {"t": 1, "q": 0.25, "goal": 3}]}'
    (columns,) = read_json(log, {"records": "entries"})
    assert {name: values.tolist() for name, values in columns.items()} == {"t": [0, 1], "q": [0.5, 0.25]}


def test_lists_under_a_key_of_a_log_are_columns():
    log = b'{"specimen": {"force": [9.0]}, "test": {"name": "a", "force": [1, 2], "displacement": [0, 0.5]}}'
    (columns,) = read_json(log, {"under": "test"})
    lists = {name: values.tolist() for name, values in columns.items()}
    assert lists == {"force": [1, 2], "displacement": [0, 0.5]}


def test_series_of_all_phases_of_a_log_are_joined():
    phases = [{"graph": {"t": [0, 1], "q": [2, 3], "n": 2}}, {"graph": {"t": [1, 2], "q": [3, 5], "n": 0}}]
    log = json.dumps({"program": 4, "phases": phases}).encode()
    (columns,) = read_json(log, {"graphs": ["phases", "graph"]})
    joined = {"t": [0, 1, 1, 2], "q": [2, 3, 3, 5]}
    assert {name: values.tolist() for name, values in columns.items()} == joined


def test_falling_clock_begins_a_run_and_each_item_makes_one(tmp_path):
    rows = ["t;Fa;Fb", *(f"{t};{i};{10 * i}" for i, t in enumerate([0, 1, 2, 0, 1, 2]))]
    (tmp_path / "a.txt").write_text("\n".join(rows))
    read = SEMICOLONS | {"files": ["a.txt"], "skip": 1, "restarts": "t", "each": ["a", "b"]}
    table = converted(tmp_path, {"time_s": "t", "force_N": "F{}"}, more={"raw": []}, **read)
    assert table["run"] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert table["force_N"] == [0, 1, 2, 0, 10, 20, 3, 4, 5, 30, 40, 50]
    assert (tmp_path / "out/raw/0 a.txt").read_text() == "\n".join(rows)


def test_joined_matlab_files_are_chained_and_cut_to_a_range(tmp_path):
    cell = np.empty((1, 1), dtype=object)
    cell[0, 0] = np.arange(3.0, 0.0, -1.0)
    savemat(tmp_path / "a.mat", {"up": np.arange(4.0), "down": cell})
    savemat(tmp_path / "b.mat", {"up": 10.0 * np.arange(4.0), "down": cell})
    read = {"format": "matlab", "files": ["a.mat", "b.mat"], "join": ["x", "f"]}
    read |= {"within": {"x_m": [0.5, 2.5]}, "chain": {"x": ["x.up", "x.down"], "f": ["f.up", "f.down"]}}
    table = converted(tmp_path, {"time_s": {"step": 0.1}, "x_m": "x", "force_N": "f"}, **read)
    assert table["x_m"] == [1, 2, 2, 1]
    assert table["force_N"] == [10, 20, 2, 1]
    assert table["time_s"] == [0.1, 0.2, 0.5, 0.6]


def test_fields_of_a_matlab_structure_are_columns_by_their_names(tmp_path):
    run = {"t": np.arange(3.0), "q": np.array([1.0, 2.0, 4.0])}
    savemat(tmp_path / "a.mat", {"foot": {"soft": run, "stiff": {**run, "q": 2.0 * run["q"]}, "name": "x"}})
    columns = {"time_s": "foot.{}.t", "position_rad": "foot.{}.q"}
    table = converted(tmp_path, columns, format="matlab", files=["a.mat"], each=["soft", "stiff"])
    assert table["run"] == [0, 0, 0, 1, 1, 1]
    assert table["position_rad"] == [1, 2, 4, 2, 4, 8]


def test_items_of_an_array_of_structures_are_named_by_their_number(tmp_path):
    signals = np.zeros((1, 2), dtype=[("values", object), ("label", object)])
    signals[0, 0] = (np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]]), "x")
    signals[0, 1] = (np.array([[5.0], [6.0], [7.0]]), "x")
    savemat(tmp_path / "a.mat", {"scope": {"time": np.arange(3.0), "signals": signals}})
    columns = {"time_s": "scope.time", "q_rad": "scope.signals.0.values.1", "u_Nm": "scope.signals.1.values"}
    table = converted(tmp_path, columns, format="matlab", files=["a.mat"])
    assert table["q_rad"] == [10, 20, 30]
    assert table["u_Nm"] == [5, 6, 7]


@pytest.mark.parametrize(
    ("text", "read", "source", "force"),
    [
        ("0,1,2\n3,4,5\n", {"delimiter": ",", "transpose": True}, "1", [(0, 3), (1, 4), (2, 5)]),
        ("\n\n".join("012345") + "\n", {"width": 3}, "2", [(0, 2), (3, 5)]),
        ("t,F\n0,[1 2\n 3]\n4,[5 6\n 7]\n", {"skip": 1, "width": 2, "blanks": ",[]"}, "3", [(0, 3), (4, 7)]),
    ],
    ids=["a line for each column", "a line for each number", "an array over two lines"],
)
def test_recipe_converts_lines_to_rows(tmp_path, text, read, source, force):
    (tmp_path / "a.txt").write_text(text)
    table = converted(tmp_path, {"time_s": "0", "force_N": source}, format="text", files=["a.txt"], **read)
    assert list(zip(table["time_s"], table["force_N"], strict=True)) == force


@pytest.mark.parametrize(
    ("sheets", "force"), [("Test *", [1, 2, 2, 4]), (["Test 2", "Test 1"], [2, 4, 1, 2])]
)
def test_sheets_that_match_or_are_listed_are_runs_in_their_order(tmp_path, sheets, force):
    book = openpyxl.Workbook()
    for number, title in enumerate(["Results", "Test 1", "Test 2"]):
        sheet = book.create_sheet(title)
        for row in (["t", "F"], ["s", "N"], [0, number], [1, 2 * number]):
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    read = {"format": "workbook", "files": ["a.xlsx"], "sheets": sheets, "skip": 2, "names": 0}
    table = converted(tmp_path, {"time_s": "t", "force_N": "F"}, **read)
    assert (table["run"], table["force_N"]) == ([0, 0, 1, 1], force)


WRENCH = """string frame
uint32[2] counts
int8 BUSY=3
time stamp
Wrench wrench
================================================================================
MSG: geometry_msgs/Wrench
float64 force  # N
float64 torque
"""


def bag_record(fields, data):
    """One record of a ROS bag."""
    header = b"".join(
        struct.pack("<I", len(key) + 1 + len(value)) + key + b"=" + value for key, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def write_bag(path, rows):
    """A bag of stamps, forces and torques of a topic, and of one message of another topic, in a bz2 chunk."""
    records = b""
    for number, topic in ((0, b"/wrench"), (1, b"/other")):
        about = {b"topic": topic, b"type": b"a_msgs/Reading", b"message_definition": WRENCH.encode()}
        inner = bag_record(about, b"")
        size = struct.unpack("<I", inner[:4])[0]
        fields = {b"op": b"\x07", b"conn": struct.pack("<I", number), b"topic": topic}
        records += bag_record(fields, inner[4 : 4 + size])
    for number, (second, nanosecond, force, torque) in [(0, row) for row in rows] + [(1, (9, 9, 9.0, 9.0))]:
        message = (
            struct.pack("<I", 3) + b"arm" + struct.pack("<IIIIdd", 7, 8, second, nanosecond, force, torque)
        )
        records += bag_record({b"op": b"\x02", b"conn": struct.pack("<I", number)}, message)
    chunk = bag_record({b"op": b"\x05", b"compression": b"bz2"}, bz2.compress(records))
    path.write_bytes(b"#ROSBAG V2.0\n" + bag_record({b"op": b"\x03"}, b"   ") + chunk)


def test_topic_of_a_bag_is_read_by_the_names_of_its_message(tmp_path):
    write_bag(tmp_path / "a.bag", [(1, 500_000_000, 2.0, 3.0), (2, 0, 4.0, 5.0)])
    (columns,) = read_bag((tmp_path / "a.bag").read_bytes(), {"topic": "/wrench"})
    assert {name: values.tolist() for name, values in columns.items()} == {
        "stamp": [1.5, 2.0],
        "wrench.force": [2.0, 4.0],
        "wrench.torque": [3.0, 5.0],
    }
    with pytest.raises(FileNotFoundError, match="its topics: /other, /wrench"):
        read_bag((tmp_path / "a.bag").read_bytes(), {"topic": "/missing"})


def test_files_with_clocks_of_their_own_are_joined_at_the_times_of_the_first(tmp_path):
    write_bag(tmp_path / "a.bag", [(second, 0, 10.0 * second, 0.0) for second in (10, 11, 12, 13)])
    (tmp_path / "a.txt").write_text("0.5;1\n2.5;5\n")  # ten seconds behind
    read = {"format": "bag", "topic": "/wrench", "files": ["a.bag", "a.txt"], "join": ["ft", "stage"]}
    read |= {"apart": {"stage": {"format": "text", "delimiter": ";"}}}
    read |= {"clocks": {"ft": ["stamp", 0], "stage": ["0", 10.0]}}
    columns = {"time_s": "ft.stamp", "x_m": "stage.1", "force_N": "ft.wrench.force"}
    table = converted(tmp_path, columns, **read)
    assert table == {"time_s": [11, 12], "x_m": [2, 4], "force_N": [110, 120], "run": [0, 0]}


def test_speed_is_integrated_and_signs_a_magnitude(tmp_path):
    speed = np.array([0.0, 1.0, 2.0, -1.0, -1.0])
    np.savez(tmp_path / "a.npz", time=0.5 * np.arange(5), v=speed, current=np.arange(1.0, 6.0))
    columns = {"time_s": "time", "position_rad": {"sum": {"v": 2.0}, "integral": True}}
    columns |= {"torque_Nm": {"sum": {"current": 3.0}, "signed_by": "v"}}
    table = converted(tmp_path, columns, format="numpy", files=["a.npz"])
    np.testing.assert_allclose(table["position_rad"], [0.0, 0.5, 2.0, 2.5, 1.5])
    np.testing.assert_allclose(table["torque_Nm"], [0.0, 6.0, 9.0, -12.0, -15.0])


def test_joined_file_is_read_backwards_and_short_runs_are_left_out(tmp_path):
    (tmp_path / "down.txt").write_text("0;10\n1;11\n2;12\n")
    (tmp_path / "up.txt").write_text("0;20\n1;21\n2;22\n")
    read = SEMICOLONS | {"files": ["down.txt", "up.txt"], "join": ["down", "up"], "backwards": ["up"]}
    read |= {"chain": {"x": ["down.0", "up.0"], "F": ["down.1", "up.1"]}}
    table = converted(tmp_path, {"time_s": {"step": 1.0}, "x_m": "x", "force_N": "F"}, **read)
    assert table["x_m"] == [0, 1, 2, 2, 1, 0]
    assert table["force_N"] == [10, 11, 12, 22, 21, 20]
    (tmp_path / "clock.txt").write_text("0;1\n1;2\n2;3\n0;4\n0;5\n1;6\n2;7\n")
    read = SEMICOLONS | {"files": ["clock.txt"], "restarts": "0", "shortest": 3}
    assert converted(tmp_path, {"time_s": "0", "force_N": "1"}, **read)["run"] == [0, 0, 0, 1, 1, 1]


def test_repeated_readings_of_a_matlab_array_are_averaged(tmp_path):
    readings = np.arange(24.0).reshape(2, 4, 3)  # two joints, four positions, three readings
    savemat(tmp_path / "a.mat", {"q": readings})
    columns = {"time_s": {"step": 1.0}, "position_rad": "q.1"}
    table = converted(tmp_path, columns, format="matlab", files=["a.mat"])
    np.testing.assert_allclose(table["position_rad"], readings[1].mean(axis=1))


def test_conversion_reads_the_commit_and_not_the_work_tree(tmp_path):
    def git(*arguments):
        command = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
        made = subprocess.run([*command, *arguments], check=True, capture_output=True, text=True)
        return made.stdout.strip()

    (tmp_path / "a.txt").write_text("0;1\n1;2\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "data")
    commit = git("rev-parse", "HEAD")
    (tmp_path / "a.txt").write_text("spoilt")
    recipe = recipe_of({"time_s": "0", "force_N": "1"}, SEMICOLONS)
    assert convert(recipe, Origin(tmp_path, commit), tmp_path / "out") == 2


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"\*\.txt"):
        converted(tmp_path, {"time_s": "0"}, **SEMICOLONS)


def test_surface_is_where_force_leaves_the_free_approach(tmp_path):
    x = np.concatenate([np.linspace(0.0, 10.0, 201), np.linspace(10.0, 0.0, 201)])
    force = 3.0 + 2.0 * np.maximum(x - 6.0, 0.0) + 1e-3 * np.sin(37.0 * x)
    np.savetxt(tmp_path / "a.txt", np.column_stack([10.0 * np.arange(402), x, force]), delimiter=";")
    table = converted(tmp_path, TRIALS | {"time_s": "0", "force_N": "2"}, **SEMICOLONS, surface=5)
    assert table["displacement_m"][0] == pytest.approx(-6e-3, abs=1e-4)
    assert table["force_N"][200] == pytest.approx(8.0, abs=0.01)


def write_motion(path, *, coulomb, noise):
    rng = np.random.default_rng(1)
    with path.open("w") as file:
        file.write("time_s,position_rad,velocity_rad_s,torque_Nm,run\n")
        for run in range(4):
            t = np.arange(0.0, 10.0, 0.01)
            q, w = np.sin((1.0 + 0.3 * run) * t), 1.0 + 0.3 * run
            v, a = w * np.cos(w * t), -(w**2) * q
            torque = 0.2 * a + 0.1 * v + coulomb * np.sign(v) + rng.normal(0.0, noise, len(t))
            for row in zip(t, q, v, torque, strict=True):
                file.write(",".join(f"{value:.9g}" for value in row) + f",{run}\n")


def test_ladder_finds_existing_friction_and_nothing_in_noise(tmp_path):
    write_motion(tmp_path / "a.csv", coulomb=0.5, noise=0.02)
    ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    errors = {name: ladder.attempt(name)[0] for name in ladder.built}
    best = min(errors, key=errors.__getitem__)
    assert TERMS[best].kind == "friction"
    assert errors[best] < 0.06 < 0.15 < ladder.error
    write_motion(tmp_path / "a.csv", coulomb=0.0, noise=0.02)
    ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    assert min(ladder.attempt(name)[0] for name in ladder.built) > 0.97 * ladder.error


def test_thinned_ladder_keeps_eight_runs_and_so_many_rows(tmp_path):
    write_motion(tmp_path / "a.csv", coulomb=0.5, noise=0.02)
    s = load(tmp_path / "a.csv")
    s.run = np.arange(len(s.run)) // 400
    part = thin(s, 500)
    assert np.unique(part.run).tolist() == list(range(8))
    assert 400 < len(part.x) <= 500
    assert np.isin(part.effort, s.effort).all()


RECIPE = {
    "name": "x",
    "expected": {
        "kinds": ["friction"],
        "groups": {"friction": ["coulomb_friction"], "inertia": ["armature"]},
    },
}
BUDGET = [
    {"kind": "friction", "necessary": 0.5, "sufficient": 0.8, "form": "unknown", "effects": []},
    {"kind": "drift", "necessary": 0.1, "sufficient": 0.9, "form": "exact", "effects": ["drift"]},
]


def named(*effects, **more):
    accepted = [{"effect": effect, "confused_with": []} for effect in effects]
    return {"verdict": "missing", "accepted": accepted, **more}


def test_score_takes_the_kind_with_the_largest_share_or_none():
    result = score(RECIPE, named(budget=BUDGET), 1.0)
    assert (result.kind, result.kind_right, result.form_right) == ("friction", True, True)
    wrong = score(RECIPE, named(budget=BUDGET[1:]), 1.0)
    assert (wrong.kind_right, wrong.kind_stated) == (False, False)
    replaceable = [{**BUDGET[1], "replaceable_by": ["friction"]}]
    stated = score(RECIPE, named(budget=replaceable), 1.0)
    assert (stated.kind_right, stated.kind_stated) == (False, True)
    result = score(RECIPE, named("coulomb_friction"), 1.0)
    assert (result.kind, result.kind_right, result.form_right, result.false_names) == (None, False, True, [])


def test_score_counts_false_names_except_indistinguishable_ones():
    assert score(RECIPE, named("drift"), 1.0).false_names == ["drift"]
    alike = named("drift")
    alike["accepted"][0]["confused_with"] = ["coulomb_friction"]
    assert score(RECIPE, alike, 1.0).false_names == []
    unsure = named("drift")
    unsure["accepted"][0]["form"] = "unknown"
    assert score(RECIPE, unsure, 1.0).false_names == []


def test_verdict_allowed_by_the_recipe_is_right_and_a_rejected_recording_wrong():
    recipe = {**RECIPE, "expected": {**RECIPE["expected"], "verdicts": ["insufficient"]}}
    fair = score(recipe, {"verdict": "insufficient"}, 1.0)
    assert (fair.kind_right, fair.form_right, fair.false_names) == (True, True, [])
    assert not score(recipe, {"verdict": "adequate"}, 1.0).kind_right
    refused = score(RECIPE, {"verdict": "refused", "reason": "no"}, 1.0)
    assert (refused.kind_right, refused.form_right) == (False, False)
    assert "refused 1" in summary([refused])
