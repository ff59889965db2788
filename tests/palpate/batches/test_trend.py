"""`palpate trend`: steps and drifts with known dates, quiet series, dates, exit code and JSON, --follow."""

import json
import os
import subprocess
import sys
import time
from datetime import date, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from palpate.batches.table import head
from palpate.batches.trend import LEVEL, Series, find_changes, is_isolated, time_axis
from palpate.commands.trend import describe_change
from palpate.robot_io.errors import InputError
from tests.palpate.cli import ROOT, as_json, assert_refused, run
from tests.palpate.presses import write_presses


def series(values, std_errs):
    places = np.arange(len(values))
    return Series("all", "joint_1", "coulomb_friction.torque", "N m", places, places * 1.0, values, std_errs)


def nights(rng, truth, scatter=0.03):
    """Values with a scatter between nights and standard errors, both known."""
    std_errs = rng.uniform(0.3, 0.7, len(truth)) * scatter
    between = np.sqrt(scatter**2 - np.mean(std_errs**2))
    noise = between * rng.standard_normal(len(truth)) + std_errs * rng.standard_normal(len(truth))
    return series(truth + noise, std_errs)


def test_steps_are_dated_within_three_nights():
    rng = np.random.default_rng(1)
    dated = 0
    for _ in range(30):
        place = int(rng.integers(12, 48))
        changes = find_changes(nights(rng, 1.0 + 0.1 * (np.arange(60) >= place)), LEVEL / 10)
        dated += any(change.kind == "step" and abs(change.first - place) <= 3 for change in changes)
    assert dated >= 27
    truth = 1.0 + 0.2 * (np.arange(90) >= 30) - 0.3 * (np.arange(90) >= 60)
    first, second = find_changes(nights(np.random.default_rng(3), truth), LEVEL / 10)
    assert (first.kind, second.kind) == ("step", "step")
    assert abs(first.first - 30) <= 1
    assert abs(second.first - 60) <= 1


def box(count, *sides):
    """One between the first and second side, and between the third and fourth, else zero."""
    return np.searchsorted(sides, np.arange(count), "right") % 2 * 1.0


@pytest.mark.parametrize(
    ("truth", "steps", "drifts"),
    [
        (10.0 * box(40, 17, 23), [17, 23], []),
        (3.0 * box(60, 25, 35), [25, 35], []),
        (4.0 * box(80, 20, 28, 50, 58), [20, 28, 50, 58], []),
        (np.linspace(0.0, 9.0, 60) * (np.arange(60) < 40), [40], [(0, 39)]),
        (np.arange(60) % 30 / 4.0, [30], [(0, 29), (30, 59)]),
    ],
)
def test_excursions_and_drifts_that_end_in_a_step_are_recovered(truth, steps, drifts):
    recovered = 0
    for seed in range(10):
        noise = np.random.default_rng(seed).standard_normal(len(truth))
        changes = find_changes(series(truth + noise, np.full(len(truth), 0.1)), LEVEL / 10)
        found = [change.first for change in changes if change.kind == "step"]
        ends = [(change.first, change.last) for change in changes if change.kind == "drift"]
        recovered += len(found) == len(steps) and len(ends) == len(drifts)
        recovered -= any(abs(a - b) > 6 for a, b in zip(np.ravel(ends), np.ravel(drifts), strict=False))
        recovered -= any(abs(a - b) > 3 for a, b in zip(found, steps, strict=False))
    assert recovered >= 8


@pytest.mark.parametrize("size", [0.1, 1.0, 100.0])
def test_error_of_a_step_comes_from_the_scatter_whatever_the_size_of_the_step(size):
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(10):
        values = 1.0 + 0.03 * rng.standard_normal(40) - size * (np.arange(40) >= 20)
        (change,) = find_changes(series(values, np.full(40, 0.001)), LEVEL / 10)
        errors.append(change.std_err)
    assert np.mean(errors) == pytest.approx(0.03 * np.sqrt(2 / 20), rel=0.15)


@pytest.mark.parametrize(
    ("steps", "uncertain"),
    [
        ({20: 15.0}, True),  # one value has a standard error of twice the step
        ({10: 10.0, 30: 20.0}, False),
        ({14: 10.0, 22: -10.0}, False),  # an excursion
    ],
)
def test_errors_cover_the_sizes_of_all_steps(steps, uncertain):
    count, covered, found = 40, 0, 0
    std_errs = np.full(count, 0.1)
    std_errs[5] = 30.0 if uncertain else 0.1
    for seed in range(40):
        values = np.random.default_rng(seed).normal(400.0, 1.0, count)
        for first, size in steps.items():
            values[first:] += size
        for change in find_changes(series(values, std_errs), LEVEL):
            if change.first in steps:
                found += 1
                covered += abs(change.after - change.before - steps[change.first]) <= 2.0 * change.std_err
    assert found > 10
    assert covered >= 0.85 * found


def test_step_without_any_scatter_is_found():
    (change,) = find_changes(series(np.repeat([0.0, 1.0], 20), np.zeros(40)), LEVEL / 10)
    assert (change.kind, change.first) == ("step", 20)
    assert (change.before, change.after) == (0.0, pytest.approx(1.0, rel=1e-14))


def test_drift_is_no_step_and_its_size_is_known():
    (change,) = find_changes(nights(np.random.default_rng(2), np.linspace(1.0, 1.3, 80)), LEVEL / 10)
    assert change.kind == "drift"
    assert change.after - change.before == pytest.approx(0.3, abs=4 * change.std_err)
    assert change.std_err < 0.03


def test_constant_series_and_changes_within_errors_do_not_change():
    rng = np.random.default_rng(4)
    false = [
        find_changes(series(1.0 + 0.05 * draw(60), np.zeros(60)), 0.01)
        for draw in (rng.standard_normal, lambda n: rng.standard_t(3, n), lambda n: rng.exponential(size=n))
        for _ in range(60)
    ]
    assert sum(map(bool, false)) <= 6  # 1.8 expected
    values = 1.0 + 0.01 * (np.arange(40) >= 20) + 1e-4 * np.random.default_rng(5).standard_normal(40)
    assert find_changes(series(values, np.full(40, 1e-4)), 0.001)
    assert not find_changes(series(values, np.full(40, 0.1)), 0.001)


def stepping(seed=5):
    return 1.0 + 0.2 * (np.arange(40) >= 25) + 0.01 * np.random.default_rng(seed).standard_normal(40)


@pytest.mark.parametrize("place", [0, 1, 7, 24, 25, 38, 39])
@pytest.mark.parametrize("away", [0.35, 39.0, -0.35])
def test_single_outlier_is_isolated(place, away):
    values = stepping()
    values[place] += away
    assert np.flatnonzero(is_isolated(values)).tolist() == [place]


def test_steps_excursions_and_recurring_faults_are_not_isolated():
    quiet, nights = 0.01 * np.random.default_rng(5).standard_normal(40), np.arange(40)
    assert not is_isolated(stepping()).any()
    assert not is_isolated(quiet + (nights >= 38)).any()  # a step two nights ago
    assert not is_isolated(quiet + ((nights >= 20) & (nights < 22))).any()
    assert not is_isolated(quiet + ((nights >= 21) & (nights % 3 == 0))).any()
    assert not is_isolated(np.zeros(40)).any()
    assert not is_isolated(np.ones(1)).any()


def write_table(folder, values, days, std_err=0.01):
    folder.mkdir(exist_ok=True)
    count = len(values)
    table = pa.table(
        {
            "measurement": [f"log{number}.csv" for number in range(count)],
            "group": ["left"] * count,
            "date": [day.isoformat() for day in days],
            "channel": ["joint_1"] * count,
            "times_noise": list(1.0 + 0.01 * np.random.default_rng(9).standard_normal(count)),
            head("coulomb_friction.torque", "N m"): list(values),
            head("coulomb_friction.torque", "N m", "std_err"): [std_err] * count,
        }
    )
    pq.write_table(table, folder / "table.parquet")


DAYS = [date(2026, 1, 1) + timedelta(days=number) for number in range(40)]


def test_trend_command_reports_changes_and_its_exit_code(tmp_path):
    rng = np.random.default_rng(6)
    order = rng.permutation(40)  # of the rows in the table
    values = (0.2 + 0.04 * (np.arange(40) >= 25) + 0.003 * rng.standard_normal(40))[order]
    write_table(tmp_path / "nightly", values, [DAYS[number] for number in order], 0.001)
    said = as_json("trend", tmp_path / "nightly")
    (change,) = said["changes"]
    assert said["time"] == "date"
    assert (change["kind"], change["series"], change["group"]) == ("step", "coulomb_friction.torque", "left")
    assert change["first"] == DAYS[25].isoformat()
    assert change["after"] - change["before"] == pytest.approx(0.04, abs=0.005)
    asked = run("trend", tmp_path / "nightly", "--exit-code")
    assert asked.exit_code == 10
    assert "steps from 0.2" in asked.stdout
    assert "(+20 %)" in asked.stdout or "(+19 %)" in asked.stdout or "(+21 %)" in asked.stdout
    assert "coulomb_friction.torque" in (tmp_path / "nightly" / "trend.html").read_text()
    quiet = run("trend", tmp_path / "nightly", "--exit-code", "--parameter", "times_noise")
    assert quiet.exit_code == 0
    assert "nothing changes" in quiet.stdout


@pytest.mark.parametrize(("before", "share"), [(2.0, " (+50 %)"), (0.1, ""), (0.0, ""), (-0.1, "")])
def test_change_from_a_value_near_zero_has_no_percentage(before, share):
    change = {"group": "all", "channel": "joint_1", "series": "bias.value", "unit": "N m", "kind": "step"}
    change |= {"first": "3", "last": "9", "before": before, "after": 1.5 * before, "std_err": 0.2}
    assert describe_change(change).endswith(f" N m{share} at 3")


def test_failed_night_does_not_hide_a_step_and_is_stated(tmp_path):
    values = 0.2 + 0.04 * (np.arange(40) >= 25) + 0.003 * np.random.default_rng(6).standard_normal(40)
    values[10] = 19.0
    write_table(tmp_path / "nightly", values, DAYS, 0.001)
    said = as_json("trend", tmp_path / "nightly")
    assert [(change["kind"], change["first"]) for change in said["changes"]] == [("step", "2026-01-26")]
    (entry,) = said["left_out"]
    assert (entry["series"], entry["at"], entry["value"]) == ("coulomb_friction.torque", "2026-01-11", 19.0)
    assert "1 isolated value left out" in run("trend", tmp_path / "nightly").stdout
    write_table(tmp_path / "nightly", values[1:11], DAYS[:10], 0.001)  # nine besides the isolated one suffice
    said = as_json("trend", tmp_path / "nightly", "--parameter", "coulomb_friction.torque")
    assert (said["tested"], len(said["left_out"])) == (1, 1)


def test_series_too_short_for_a_step_are_counted_instead_of_reported_as_unchanged(tmp_path):
    values = 0.3 + 0.08 * (np.arange(12) >= 7) + 0.0003 * np.random.default_rng(6).standard_normal(12)
    write_table(tmp_path / "nightly", values, DAYS[:12], 0.0003)
    table = pq.read_table(tmp_path / "nightly" / "table.parquet")
    for number in range(8):  # 10 series, so that one needs a p-value below 0.001; 12 values give 2 in 924
        column = pa.array(list(np.random.default_rng(number).standard_normal(12)))
        table = table.append_column(head(f"weight.g{number}", "N m"), column)
        table = table.append_column(head(f"weight.g{number}", "N m", "std_err"), pa.array([0.1] * 12))
    pq.write_table(table, tmp_path / "nightly" / "table.parquet")
    content = as_json("trend", tmp_path / "nightly")
    assert (content["tested"], content["changes"]) == (10, [])
    assert (content["least_for_step"], content["short"]) == (14, 10)
    stated = run("trend", tmp_path / "nightly").stdout
    assert "10 of 10 series. With 10 series, each needs 14 measurements" in " ".join(stated.split())
    assert "nothing changes" not in stated
    assert "too short to detect a step" in (tmp_path / "nightly" / "trend.html").read_text()
    (alone,) = as_json("trend", tmp_path / "nightly", "--parameter", "coulomb_friction.torque")["changes"]
    assert (alone["kind"], alone["first"]) == ("step", DAYS[7].isoformat())


def test_constant_parameter_is_reported_as_constant(tmp_path):
    write_table(tmp_path / "nightly", np.full(40, 0.2), DAYS)
    series = ("--parameter", "coulomb_friction.torque", "--exit-code")
    told = run("trend", tmp_path / "nightly", *series)
    assert told.exit_code == 0
    stated = " ".join(told.stdout.split())
    assert (
        "not tested, because all measurements have the same value: left joint_1 coulomb_friction.torque"
        in stated
    )
    assert "needs at least" not in stated
    said = as_json("trend", tmp_path / "nightly")
    assert (said["tested"], said["constant"]) == (1, ["left joint_1 coulomb_friction.torque"])


def test_single_date_is_refused_and_a_constant_date_column_is_skipped(tmp_path):
    write_table(tmp_path / "nightly", 0.2 + 0.001 * np.arange(40), [DAYS[0]] * 40)
    assert_refused(run("trend", tmp_path / "nightly"), "all 40 measurements have the same value, 2026-01-01")
    write_table(tmp_path / "first", np.array([0.2]), [DAYS[0]])
    assert as_json("trend", tmp_path / "first")["tested"] == 0
    table = pq.read_table(tmp_path / "nightly" / "table.parquet")
    table = table.append_column("timestamp", pa.array([float(number) for number in range(40)]))
    assert time_axis(table)[2] == "timestamp"


def dated(*labels):
    return pa.table({"measurement": [f"n{n}" for n in range(len(labels))], "date": list(labels)})


def test_dates_with_and_without_a_time_zone_are_not_mixed():
    with pytest.raises(
        InputError, match=r"'2026-03-01T03:00\+02:00' in row 2 .* '2026-03-01T02:00' in row 1"
    ):
        time_axis(dated("2026-03-01T02:00", "2026-03-01T03:00+02:00"))
    times, _, what = time_axis(dated("2026-03-01T02:00Z", "2026-03-01T03:00+02:00"))
    assert what == "date"
    assert times[1] - times[0] == pytest.approx(-1 / 24)  # 01:00 UTC


def test_months_are_dates():
    times, _, what = time_axis(dated("2024-01", "2024-02", "2024-03", "2025-03"))
    assert what == "date"
    assert np.diff(times).tolist() == [31, 29, 365]
    with pytest.raises(InputError, match="2024-13"):
        time_axis(dated("2024-12", "2024-13"))


def test_invalid_trend_tables_are_reported(tmp_path):
    write_table(tmp_path / "few", np.arange(5.0), DAYS[:5])
    assert "needs at least 10" in run("trend", tmp_path / "few").stdout
    assert_refused(run("trend", tmp_path), "contains no table from palpate batch")
    assert_refused(run("trend", tmp_path / "few", "--date", "channel"), "--date channel: give dates")
    assert_refused(run("trend", tmp_path / "few", "--date", "night"), "no such column")
    refused = run("trend", tmp_path / "few", "--parameter", "mass")
    assert_refused(refused, "--parameter mass", "Available: none")
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    assert_refused(run("trend", tmp_path / "table.csv"), "lacks the columns")
    (tmp_path / "table.csv").write_bytes(b"\xed\x92\xff,\xfe\n1,2\n")
    assert_refused(run("trend", tmp_path / "table.csv"), "cannot be read")


def test_cell_without_a_date_is_refused_among_dates(tmp_path):
    for name, labels in (("one", ["2026-01-01"] * 11 + ["03.10.2026"]), ("all", ["03.10.2026"] * 12)):
        table = pa.table(
            {"measurement": [f"n{n}" for n in range(12)], "channel": ["axis"] * 12, "date": labels}
        )
        pq.write_table(table, tmp_path / f"{name}.parquet")
    assert_refused(
        run("trend", tmp_path / "one.parquet"),
        "column date, row 12: '03.10.2026' is not a date or number like the others",
    )
    asked = run("trend", tmp_path / "all.parquet")
    assert asked.exit_code == 0
    assert "column date has no dates" in " ".join(asked.stderr.split())


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"channel": [["contact"]] * 2}, "column 'channel' holds list"),
        ({"stiffness.k [N/m]": ["1", "<b>"]}, "column 'stiffness.k [N/m]' holds string, expected numbers"),
        ({"stiffness.k [N/m]": [True, False]}, "holds bool, expected numbers"),
        ({"stiffness.k std_err [N/m]": [{"a": 1}] * 2}, "column 'stiffness.k std_err [N/m]' holds struct"),
        ({"times_noise": ["1", "2"]}, "column 'times_noise' holds string"),
    ],
)
def test_table_with_wrong_columns_is_refused(tmp_path, change, why):
    columns = {"measurement": ["a", "b"], "channel": ["contact"] * 2}
    parameter = {"stiffness.k [N/m]": [1.0, 2.0], "stiffness.k std_err [N/m]": [0.1, 0.1]}
    pq.write_table(pa.table(columns | parameter | change), tmp_path / "table.parquet")
    assert_refused(run("trend", tmp_path), why)


def test_table_with_a_repeated_column_or_a_pipe_is_refused(tmp_path):
    (tmp_path / "twice.csv").write_text("measurement,measurement,channel\na,b,contact\n")
    assert_refused(run("trend", tmp_path / "twice.csv"), "has the column 'measurement' twice")
    os.mkfifo(tmp_path / "pipe.csv")
    assert_refused(run("trend", tmp_path / "pipe.csv"), "no such regular file")


def test_table_is_read_again_only_when_new(tmp_path, monkeypatch):
    """The page that a look writes beside the table is nothing new."""
    folder, waits = tmp_path / "nightly", []
    write_table(folder, 1.0 + 0.01 * np.random.default_rng(7).standard_normal(20), DAYS[:20])

    def wait(seconds):
        waits.append(seconds)
        if len(waits) == 2:
            write_table(folder, 1.0 + 0.01 * np.random.default_rng(8).standard_normal(21), DAYS[:21])
        if len(waits) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr("palpate.commands.trend.time.sleep", wait)
    assert run("trend", folder, "--follow", "--every-s", 5).stdout.count("series tested") == 2
    assert waits == [5.0] * 4


def test_without_dates_the_order_counts_and_numbers_are_used_as_given():
    table = pa.table({"measurement": ["b", "b", "a"], "channel": ["x", "y", "x"], "cycles": [100, 100, 2000]})
    times, labels, what = time_axis(table)
    assert (times.tolist(), labels, what) == ([1.0, 1.0, 2.0], ["b", "b", "a"], "count")
    assert time_axis(table, "cycles")[0].tolist() == [100.0, 100.0, 2000.0]
    with pytest.raises(InputError, match="such as 2026-11-23"):
        time_axis(table, "channel")


@pytest.mark.slow
def test_recordings_folder_is_followed(tmp_path):
    logs, out = tmp_path / "logs", tmp_path / "out"
    logs.mkdir()

    def record(number):
        k = 400.0 if number < 8 else 480.0
        law = lambda x, v: k * x + 6.0 * v  # noqa: E731
        path = logs / f"{DAYS[number].isoformat()}.csv"
        write_presses(path.with_suffix(".tmp"), speeds_m_s=(0.04, 0.08), force_of=law, seed=number)
        path.with_suffix(".tmp").rename(path)

    for number in range(8):
        record(number)
    command = [sys.executable, "-u", "-m", "palpate.main", "trend", str(logs), "--out", str(out)]
    command += ["--pattern", "{date}.csv", "--add", "dry_friction", "--follow", "--every-s", "1", "--json"]
    following = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        first = read_json(following.stdout)
        assert (first["measurements"], first["tested"], first["changes"]) == (8, 0, [])
        for number in range(8, 16):
            record(number)
        while (said := read_json(following.stdout))["measurements"] < 16:
            time.sleep(0.1)
    finally:
        following.kill()
        following.communicate()
    (change,) = (change for change in said["changes"] if change["series"] == "stiffness.k")
    assert (change["kind"], change["first"]) == ("step", DAYS[8].isoformat())
    assert "dry_friction.force [N]" in (out / "table.csv").read_text().splitlines()[0]
    refused = run("trend", out, "--add", "dry_friction")
    assert_refused(refused, "--add: applies only if recordings are processed; add --out")


def read_json(stream):
    """The next JSON document of a stream."""
    text = ""
    while line := stream.readline():
        text += line
        if line.rstrip() == "}":
            return json.loads(text)
    raise AssertionError(text)
