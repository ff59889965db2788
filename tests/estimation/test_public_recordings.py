"""Recipes of public recordings: conversion, split, ladder and score, on files made here."""

import csv
import gzip
import hashlib
import struct
import subprocess
from functools import cache

import numpy as np
import pytest

from benchmarks.measured.convert import RECIPES, SPLITS, Origin, convert, load_recipe, split_of
from benchmarks.measured.ladder import TERMS, Ladder, load
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


def test_reading_whose_sign_bit_is_set_is_negative(tmp_path):
    (tmp_path / "servo.txt").write_text("0 40\n1 1074\n")
    load = {"sum": {"1": 1.0}, "sign_bit": 1024}
    table = converted(tmp_path, {"time_s": "0", "torque_Nm": load}, format="text", files=["servo.txt"])
    assert table["torque_Nm"] == [40.0, -50.0]


def test_lists_of_rows_are_runs(tmp_path):
    (tmp_path / "drive.json").write_text('{"unit": "m", "fast": [[0, 7], [1, 8]], "slow": [[0, 1], [1, 2]]}')
    read = {"format": "json", "files": ["drive.json"], "tables": ["slow", "fast"], "names": ["t", "volts"]}
    table = converted(tmp_path, {"time_s": "0", "force_N": "volts"}, **read)
    assert table == {"time_s": [0, 1, 0, 1], "force_N": [1, 2, 7, 8], "run": [0, 0, 1, 1]}


def test_trials_side_by_side_in_rows_of_numbers_are_runs(tmp_path):
    np.array([[0, 7, 0, 1], [1, 8, 1, 2]], "<f4").tofile(tmp_path / "taps.bin")
    read = {"format": "trials", "files": ["taps.bin"], "packed": "binary", "type": "<f4", "per_row": 4}
    table = converted(tmp_path, {"time_s": "x", "force_N": "y"}, **read)
    assert table == {"time_s": [0, 1, 0, 1], "force_N": [7, 8, 1, 2], "run": [0, 0, 1, 1]}


def test_rows_are_sorted_by_the_column_of_their_order(tmp_path):
    (tmp_path / "map.txt").write_text("2 6\n0 4\n1 5\n")
    columns = {"time_s": "0", "force_N": "1"}
    table = converted(tmp_path, columns, format="text", files=["map.txt"], order="0")
    assert table == {"time_s": [0, 1, 2], "force_N": [4, 5, 6], "run": [0, 0, 0]}


def test_conversion_scales_zeroes_and_numbers_runs(tmp_path):
    table = trials(tmp_path)
    assert table["run"] == [0] * 6 + [1] * 6
    np.testing.assert_allclose(table["time_s"][:6], 0.01 * np.arange(6))
    np.testing.assert_allclose(table["displacement_m"][6:], 1e-3 * np.arange(6), atol=1e-12)
    np.testing.assert_allclose(table["force_N"][:6], 2 * np.arange(6) + np.arange(6) + 6.5)


def test_files_with_clocks_of_their_own_are_joined_at_the_times_of_the_first(tmp_path):
    (tmp_path / "a.txt").write_text("10;100\n11;110\n12;120\n13;130\n")
    (tmp_path / "b.txt").write_text("0.5,1\n2.5,5\n")  # ten seconds behind
    read = SEMICOLONS | {"join": ["ft", "stage"], "apart": {"stage": {"delimiter": ","}}}
    read |= {"clocks": {"ft": ["0", 0], "stage": ["0", 10.0]}}
    table = converted(tmp_path, {"time_s": "ft.0", "x_m": "stage.1", "force_N": "ft.1"}, **read)
    assert table == {"time_s": [11, 12], "x_m": [2, 4], "force_N": [110, 120], "run": [0, 0]}


def test_bag_gives_times_and_numbers_of_one_topic(tmp_path):
    bags = pytest.importorskip("rosbags.rosbag1", reason="rosbags is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    state, kind = types.types["sensor_msgs/msg/JointState"], "sensor_msgs/msg/JointState"
    header, time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    writer = bags.Writer(tmp_path / "a.bag")
    writer.set_compression(writer.CompressionFormat.BZ2)
    with writer as bag:
        for topic, torque in (("/arm", 3.0), ("/other", 9.0)):
            link = bag.add_connection(topic, kind, typestore=types)
            for second in (2, 1):
                efforts = np.array([0.0, torque * second])
                message = state(
                    header(7, time(second, 500), "base"), ["q"], efforts[:1], efforts[:0], efforts
                )
                bag.write(link, second, types.serialize_ros1(message, kind))
    read = {"format": "bag", "files": ["a.bag"]}
    columns = {"time_s": "header.stamp", "torque_Nm": "effort.1", "number": "header.seq"}
    table = converted(tmp_path, columns, **read, topic="/arm")
    assert table == {"time_s": [1.0000005, 2.0000005], "torque_Nm": [3, 6], "number": [7, 7], "run": [0, 0]}
    with pytest.raises(FileNotFoundError, match="the bag's topics: /arm, /other"):
        converted(tmp_path, columns, **read, topic="/leg")


def test_links_of_a_chain_add_their_sines_to_an_igor_wave(tmp_path):
    wave = bytearray(384)
    struct.pack_into("<Ih", wave, 76, 3, 2)
    struct.pack_into("<d", wave, 148, 0.5)
    (tmp_path / "wave.ibw").write_bytes(bytes(wave) + np.array([0.0, 1.0, 2.0], "<f4").tobytes())
    columns = {"time_s": "time", "x_m": {"offset": 3.0, "sines": [[2.0, np.pi / 2, {"0": np.pi}]]}}
    table = converted(tmp_path, columns, format="ibw", files=["wave.ibw"])
    np.testing.assert_allclose(table["time_s"], [0.0, 0.5, 1.0])
    np.testing.assert_allclose(table["x_m"], [5.0, 1.0, 5.0], atol=1e-6)


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
    assert not ladder.drives("friction", ladder.attempt(best)[2])
    write_motion(tmp_path / "a.csv", coulomb=-0.5, noise=0.02)
    reversed_ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    assert reversed_ladder.drives("friction", reversed_ladder.attempt(best)[2])
    write_motion(tmp_path / "a.csv", coulomb=0.0, noise=0.02)
    ladder = Ladder(load(tmp_path / "a.csv"), ["inertia", "damping"])
    assert min(ladder.attempt(name)[0] for name in ladder.built) > 0.97 * ladder.error


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
