"""Recipes of public recordings: conversion, split, ladder and score, on files made here."""

import csv
import gzip
import hashlib
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from benchmarks.measured.convert import RECIPES, SPLITS, Origin, convert, load_recipe, read_json, split_of
from benchmarks.measured.ladder import TERMS, Ladder, load, thin
from benchmarks.measured.score import score, summary
from palpate.estimation.effects import EFFECTS
from palpate.estimation.models import MODELS

KINDS = {
    "elastic_shape",
    "rate_dependence",
    "friction",
    "time_memory",
    "inertia",
    "periodic",
    "gravity_load",
    "contact_geometry",
    "sensor_dynamics",
    "sensor_statics",
    "drift",
    "run_differences",
    "recorded_context",
}


@cache
def recipes_by_name() -> dict[str, dict]:
    return {path.stem: load_recipe(path.stem) for path in sorted(RECIPES.glob("*.yaml"))}


def test_recipe_names_only_kinds_effects_and_models_that_exist() -> None:
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


def test_split_follows_from_the_last_digit_of_the_digest_unless_the_recipe_states_it() -> None:
    for name in ("a", "b", "c", "d", "e"):
        digit = hashlib.sha256(name.encode()).hexdigest()[-1]
        assert split_of({"name": name}) == ("develop" if digit in "02468ace" else "held_out")
        assert split_of({"name": name, "split": "held_out"}) == "held_out"
    assert {split_of(recipe) for recipe in recipes_by_name().values()} == set(SPLITS)


def recipe_of(**read: Any) -> dict[str, Any]:
    return {
        "read": {"format": "text", "files": ["*.txt"], "delimiter": ";", "skip": 1, "decimal": ",", **read},
        "columns": {
            "time_s": {"sum": {"Zeit": 1e-3}},
            "displacement_m": {"sum": {"1": 1e-3}, "zero": 1},
            "force_N": {"sum": {"2": 2.0, "1": 1.0}, "offset": 5.0},
        },
    }


def rows_of(folder: Path) -> list[dict[str, float]]:
    with gzip.open(folder / "import.csv.gz", "rt") as file:
        return [{key: float(cell) for key, cell in row.items()} for row in csv.DictReader(file)]


def write_trials(folder: Path) -> None:
    for number in (1, 2):
        lines = ["Zeit;Weg;Kraft", *(f"{10 * i},0;{number + i},5;{i}" for i in range(6)), "end of test"]
        (folder / f"trial{number}.txt").write_text("\n".join(lines))


def test_conversion_scales_zeroes_and_numbers_runs(tmp_path: Path) -> None:
    write_trials(tmp_path)
    rows = convert(recipe_of(), Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert rows == len(table) == 12
    assert [row["run"] for row in table] == [0] * 6 + [1] * 6
    np.testing.assert_allclose([row["time_s"] for row in table[:6]], 0.01 * np.arange(6))
    np.testing.assert_allclose([row["displacement_m"] for row in table[6:]], 1e-3 * np.arange(6), atol=1e-12)
    np.testing.assert_allclose([row["force_N"] for row in table[:6]], 2 * np.arange(6) + np.arange(6) + 6.5)


def test_conversion_averages_blocks_and_cuts_pieces(tmp_path: Path) -> None:
    write_trials(tmp_path)
    convert(recipe_of(every=2, pieces=3), Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["run"] for row in table] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose([row["time_s"] for row in table[:3]], [0.005, 0.025, 0.045])


def test_conversion_unwraps_an_encoder_that_starts_anew(tmp_path: Path) -> None:
    turned = np.linspace(0.0, 60.0, 31) - 5.0
    wrapped = (turned + 12.5) % 25.0 - 12.5
    np.savez(tmp_path / "a.npz", time=np.arange(31.0), q=wrapped)
    columns = {
        "time_s": {"sum": {"time": 1.0}},
        "position_rad": {"sum": {"q": 2.0}, "unwrap": 50.0},
        "raw_rad": {"sum": {"q": 1.0}},
    }
    recipe = {"read": {"format": "numpy", "files": ["a.npz"]}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    np.testing.assert_allclose([row["position_rad"] for row in table], 2.0 * turned, atol=1e-6)
    np.testing.assert_allclose([row["raw_rad"] for row in table], wrapped, atol=1e-6)


def test_conversion_keeps_rows_that_are_a_step_apart(tmp_path: Path) -> None:
    write_trials(tmp_path)
    convert(recipe_of(thin=0.025), Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["time_s"] for row in table] == [0.0, 0.03, 0.0, 0.03]


def test_trials_side_by_side_have_the_columns_that_the_recipe_names(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("t;F;x;t;F;x\n0;1;2;0;10;20\n1;3;4;1;30;40\n2;5;6;;;\n")
    read = {"format": "trials", "names": ["t", "F", "x"], "decimal": "."}
    columns = {"time_s": {"sum": {"t": 1.0}}, "force_N": {"sum": {"F": 1.0}}, "x_m": {"sum": {"x": 1.0}}}
    convert({**recipe_of(**read), "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["run"] for row in table] == [0, 0, 0, 1, 1]
    assert [row["force_N"] for row in table] == [1, 3, 5, 10, 30]
    assert [row["x_m"] for row in table] == [2, 4, 6, 20, 40]


def test_conversion_unpacks_a_text_that_is_packed(tmp_path: Path) -> None:
    write_trials(tmp_path)
    plain = (tmp_path / "trial1.txt").read_bytes()
    (tmp_path / "packed.txt.gz").write_bytes(gzip.compress(plain))
    assert Origin(tmp_path, "").read("packed.txt.gz") == plain


def test_conversion_reads_vectors_and_columns_of_a_numpy_archive(tmp_path: Path) -> None:
    time, q = np.arange(4.0), np.arange(12.0).reshape(4, 3)
    np.savez(tmp_path / "a.npz", time=time, q=q, name="x")
    columns = {"time_s": {"sum": {"time": 1.0}}, "position_rad": {"sum": {"q.2": 1.0}}}
    convert(
        {"read": {"format": "numpy", "files": ["a.npz"]}, "columns": columns},
        Origin(tmp_path, ""),
        tmp_path / "out",
    )
    assert [row["position_rad"] for row in rows_of(tmp_path / "out")] == [2, 5, 8, 11]


def test_a_log_of_records_has_a_column_for_each_number() -> None:
    log = b'{"motor": "a", "entries": [{"t": 0, "q": 0.5, "goal": null}, {"t": 1, "q": 0.25, "goal": 3}]}'
    (columns,) = read_json(log, {"records": "entries"})
    assert {name: values.tolist() for name, values in columns.items()} == {"t": [0, 1], "q": [0.5, 0.25]}


def test_falling_clock_begins_a_run_and_each_item_makes_one(tmp_path: Path) -> None:
    rows = ["t;Fa;Fb", *(f"{t};{i};{10 * i}" for i, t in enumerate([0, 1, 2, 0, 1, 2]))]
    (tmp_path / "a.txt").write_text("\n".join(rows))
    recipe = recipe_of(decimal=".", files=["a.txt"], restarts="t", each=["a", "b"])
    recipe["columns"] = {"time_s": {"sum": {"t": 1.0}}, "force_N": {"sum": {"F{}": 1.0}}}
    convert({**recipe, "raw": []}, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["run"] for row in table] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert [row["force_N"] for row in table] == [0, 1, 2, 0, 10, 20, 3, 4, 5, 30, 40, 50]
    assert (tmp_path / "out/raw/0 a.txt").read_text() == "\n".join(rows)


def test_joined_matlab_files_are_chained_and_cut_to_a_range(tmp_path: Path) -> None:
    cell = np.empty((1, 1), dtype=object)
    cell[0, 0] = np.arange(3.0, 0.0, -1.0)
    savemat(tmp_path / "b.mat", {"up": 10.0 * np.arange(4.0), "down": cell})
    read = {
        "format": "matlab",
        "files": ["a.mat", "b.mat"],
        "join": ["x", "f"],
        "within": {"x_m": [0.5, 2.5]},
    }
    savemat(tmp_path / "a.mat", {"up": np.arange(4.0), "down": cell})
    chain = {"x": ["x.up", "x.down"], "f": ["f.up", "f.down"]}
    columns = {"time_s": {"step": 0.1}, "x_m": {"sum": {"x": 1.0}}, "force_N": {"sum": {"f": 1.0}}}
    recipe = {"read": {**read, "chain": chain}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["x_m"] for row in table] == [1, 2, 2, 1]
    assert [row["force_N"] for row in table] == [10, 20, 2, 1]
    assert [row["time_s"] for row in table] == [0.1, 0.2, 0.5, 0.6]


def test_fields_of_a_matlab_structure_are_columns_by_their_names(tmp_path: Path) -> None:
    run = {"t": np.arange(3.0), "q": np.array([1.0, 2.0, 4.0])}
    savemat(tmp_path / "a.mat", {"foot": {"soft": run, "stiff": {**run, "q": 2.0 * run["q"]}, "name": "x"}})
    read = {"format": "matlab", "files": ["a.mat"], "each": ["soft", "stiff"]}
    columns = {"time_s": {"sum": {"foot.{}.t": 1.0}}, "position_rad": {"sum": {"foot.{}.q": 1.0}}}
    convert({"read": read, "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["run"] for row in table] == [0, 0, 0, 1, 1, 1]
    assert [row["position_rad"] for row in table] == [1, 2, 4, 2, 4, 8]


def test_items_of_an_array_of_structures_are_named_by_their_number(tmp_path: Path) -> None:
    signals = np.zeros((1, 2), dtype=[("values", object), ("label", object)])
    for i, values in enumerate(
        (np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]]), np.array([[5.0], [6.0], [7.0]]))
    ):
        signals[0, i] = (values, "x")
    savemat(tmp_path / "a.mat", {"scope": {"time": np.arange(3.0), "signals": signals}})
    columns = {
        "time_s": {"sum": {"scope.time": 1.0}},
        "position_rad": {"sum": {"scope.signals.0.values.1": 1.0}},
        "torque_Nm": {"sum": {"scope.signals.1.values": 1.0}},
    }
    recipe = {"read": {"format": "matlab", "files": ["a.mat"]}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["position_rad"] for row in table] == [10, 20, 30]
    assert [row["torque_Nm"] for row in table] == [5, 6, 7]


def test_lines_that_hold_a_column_each_are_transposed(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("0,1,2\n3,4,5\n")
    columns = {"time_s": {"sum": {"0": 1.0}}, "force_N": {"sum": {"1": 1.0}}}
    read = {"format": "text", "delimiter": ",", "files": ["a.txt"], "transpose": True}
    convert({"read": read, "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    assert [(row["time_s"], row["force_N"]) for row in rows_of(tmp_path / "out")] == [(0, 3), (1, 4), (2, 5)]


def test_numbers_on_lines_of_their_own_make_rows_of_the_stated_width(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("\n\n".join(str(number) for number in range(6)) + "\n")
    columns = {"time_s": {"sum": {"0": 1.0}}, "torque_Nm": {"sum": {"2": 1.0}}}
    recipe = {"read": {"format": "text", "files": ["a.txt"], "width": 3}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    assert [(row["time_s"], row["torque_Nm"]) for row in rows_of(tmp_path / "out")] == [(0, 2), (3, 5)]


def test_sheets_that_match_are_runs(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for number, title in enumerate(["Results", "Test 1", "Test 2"]):
        sheet = book.create_sheet(title)
        for row in (["t", "F"], ["s", "N"], [0, number], [1, 2 * number]):
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    read = {"format": "workbook", "files": ["a.xlsx"], "sheets": "Test *", "skip": 2, "names": 0}
    columns = {"time_s": {"sum": {"t": 1.0}}, "force_N": {"sum": {"F": 1.0}}}
    convert({"read": read, "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    assert [(row["run"], row["force_N"]) for row in rows_of(tmp_path / "out")] == [
        (0, 1),
        (0, 2),
        (1, 2),
        (1, 4),
    ]


def test_sheets_of_a_list_are_runs_in_its_order(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for number, name in enumerate(("slow", "fast", "notes")):
        sheet = book.active if number == 0 else book.create_sheet()
        assert sheet is not None
        sheet.title = name
        for row in (["t", "x", "F"], [0.0, number, 1.0], [1.0, number, 2.0]):
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    read = {"format": "workbook", "sheets": ["fast", "slow"], "files": ["a.xlsx"]}
    columns = {"time_s": {"sum": {"t": 1.0}}, "x_m": {"sum": {"x": 1.0}}}
    convert({"read": read, "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    assert [(row["run"], row["x_m"]) for row in rows_of(tmp_path / "out")] == [(0, 1), (0, 1), (1, 0), (1, 0)]


def test_speed_is_integrated_and_gives_a_size_its_sign(tmp_path: Path) -> None:
    speed = np.array([0.0, 1.0, 2.0, -1.0, -1.0])
    np.savez(tmp_path / "a.npz", time=0.5 * np.arange(5), v=speed, current=np.arange(1.0, 6.0))
    columns = {
        "time_s": {"sum": {"time": 1.0}},
        "position_rad": {"sum": {"v": 2.0}, "integral": True},
        "torque_Nm": {"sum": {"current": 3.0}, "signed_by": "v"},
    }
    recipe = {"read": {"format": "numpy", "files": ["a.npz"]}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    np.testing.assert_allclose([row["position_rad"] for row in table], [0.0, 0.5, 2.0, 2.5, 1.5])
    np.testing.assert_allclose([row["torque_Nm"] for row in table], [0.0, 6.0, 9.0, -12.0, -15.0])


def test_joined_file_is_read_backwards_and_short_runs_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "down.txt").write_text("0;10\n1;11\n2;12\n")
    (tmp_path / "up.txt").write_text("0;20\n1;21\n2;22\n")
    read = {"format": "text", "delimiter": ";", "join": ["down", "up"], "backwards": ["up"]}
    chain = {"x": ["down.0", "up.0"], "F": ["down.1", "up.1"]}
    columns = {"time_s": {"step": 1.0}, "x_m": {"sum": {"x": 1.0}}, "force_N": {"sum": {"F": 1.0}}}
    recipe = {"read": {**read, "chain": chain, "files": ["down.txt", "up.txt"]}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert [row["x_m"] for row in table] == [0, 1, 2, 2, 1, 0]
    assert [row["force_N"] for row in table] == [10, 11, 12, 22, 21, 20]
    (tmp_path / "clock.txt").write_text("0;1\n1;2\n2;3\n0;4\n0;5\n1;6\n2;7\n")
    falling = {"format": "text", "delimiter": ";", "restarts": "0", "shortest": 3, "files": ["clock.txt"]}
    columns = {"time_s": {"sum": {"0": 1.0}}, "force_N": {"sum": {"1": 1.0}}}
    convert({"read": falling, "columns": columns}, Origin(tmp_path, ""), tmp_path / "out")
    assert [row["run"] for row in rows_of(tmp_path / "out")] == [0, 0, 0, 1, 1, 1]


def test_repeated_readings_of_a_matlab_array_are_averaged(tmp_path: Path) -> None:
    readings = np.arange(24.0).reshape(2, 4, 3)  # two joints, four positions, three readings
    savemat(tmp_path / "a.mat", {"q": readings})
    columns = {"time_s": {"step": 1.0}, "position_rad": {"sum": {"q.1": 1.0}}}
    recipe = {"read": {"format": "matlab", "files": ["a.mat"]}, "columns": columns}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    np.testing.assert_allclose([row["position_rad"] for row in table], readings[1].mean(axis=1))


def test_conversion_reads_the_commit_of_a_repository_and_not_its_work_tree(tmp_path: Path) -> None:
    def git(*arguments: str) -> str:
        command = [
            "git",
            "-C",
            str(tmp_path),
            "-c",
            "user.name=a",
            "-c",
            "user.email=a@example.org",
            *arguments,
        ]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    write_trials(tmp_path)
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "data")
    commit = git("rev-parse", "HEAD")
    (tmp_path / "trial1.txt").write_text("spoilt")
    assert convert(recipe_of(), Origin(tmp_path, commit), tmp_path / "out") == 12


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"\*\.txt"):
        convert(recipe_of(), Origin(tmp_path, ""), tmp_path / "out")


def test_surface_is_where_force_leaves_that_of_the_free_approach(tmp_path: Path) -> None:
    x = np.concatenate([np.linspace(0.0, 10.0, 201), np.linspace(10.0, 0.0, 201)])
    force = 3.0 + 2.0 * np.maximum(x - 6.0, 0.0) + 1e-3 * np.sin(37.0 * x)
    lines = ["Zeit;Weg;Kraft", *(f"{10 * i};{a};{b}" for i, (a, b) in enumerate(zip(x, force, strict=True)))]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    recipe = recipe_of(surface=5, decimal=".")
    recipe["columns"]["force_N"] = {"sum": {"2": 1.0}}
    convert(recipe, Origin(tmp_path, ""), tmp_path / "out")
    table = rows_of(tmp_path / "out")
    assert table[0]["displacement_m"] == pytest.approx(-6e-3, abs=1e-4)
    assert table[200]["force_N"] == pytest.approx(8.0, abs=0.01)


def write_motion(path: Path, *, coulomb: float, noise: float) -> None:
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


def test_ladder_finds_friction_that_is_there_and_nothing_in_noise(tmp_path):
    write_motion(tmp_path / "a.csv", coulomb=0.5, noise=0.02)
    ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    errors = {name: ladder.attempt(name)[0] for name in ladder.built}
    best = min(errors, key=errors.__getitem__)
    assert TERMS[best].kind == "friction"
    assert errors[best] < 0.06 < 0.15 < ladder.error
    write_motion(tmp_path / "a.csv", coulomb=0.0, noise=0.02)
    ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    assert min(ladder.attempt(name)[0] for name in ladder.built) > 0.97 * ladder.error


def test_thinned_ladder_keeps_eight_runs_and_so_many_rows(tmp_path: Path) -> None:
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


def named(*effects: str, **more: Any) -> dict[str, Any]:
    accepted = [{"effect": effect, "confused_with": []} for effect in effects]
    return {"verdict": "missing", "accepted": accepted, **more}


def test_score_takes_the_kind_with_the_largest_share_or_none():
    result = score(RECIPE, named(budget=BUDGET), 1.0)
    assert (result.kind, result.kind_right, result.form_right) == ("friction", True, True)
    assert not score(RECIPE, named(budget=BUDGET[1:]), 1.0).kind_right
    result = score(RECIPE, named("coulomb_friction"), 1.0)
    assert (result.kind, result.kind_right, result.form_right, result.false_names) == (None, False, True, [])


def test_score_finds_a_false_name_but_not_one_that_cannot_be_told_from_a_right_one() -> None:
    assert score(RECIPE, named("drift"), 1.0).false_names == ["drift"]
    alike = named("drift")
    alike["accepted"][0]["confused_with"] = ["coulomb_friction"]
    assert score(RECIPE, alike, 1.0).false_names == []
    unsure = named("drift")
    unsure["accepted"][0]["form"] = "unknown"
    assert score(RECIPE, unsure, 1.0).false_names == []


def test_verdict_that_the_recipe_allows_is_right_and_a_refused_recording_wrong():
    recipe = {**RECIPE, "expected": {**RECIPE["expected"], "verdicts": ["insufficient"]}}
    fair = score(recipe, {"verdict": "insufficient"}, 1.0)
    assert (fair.kind_right, fair.form_right, fair.false_names) == (True, True, [])
    assert not score(recipe, {"verdict": "adequate"}, 1.0).kind_right
    refused = score(RECIPE, {"verdict": "refused", "reason": "no"}, 1.0)
    assert (refused.kind_right, refused.form_right) == (False, False)
    assert "refused 1" in summary([refused])
