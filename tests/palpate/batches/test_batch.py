"""`palpate batch`: many files to one table and one page; grouped, resumed, interrupted, refused."""

import csv
import html
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import palpate
from palpate.batches.measurements import BatchMeasurement, find_measurements
from palpate.batches.page import write_page
from palpate.batches.pooling import BatchResult
from palpate.batches.table import make_table
from palpate.batches.tasks.measuring import write_measurement_report
from palpate.estimation.data.import_file import chosen_texts
from palpate.estimation.data.import_files import data_files
from palpate.estimation.data.import_options import NO_OPTIONS
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from palpate.study import Study
from palpate.sweep import ResultStore, run_cases, runner
from tests.files import saved
from tests.palpate.cli import ROOT, as_json, assert_refused, done, run
from tests.palpate.presses import write_presses
from tests.palpate.sweep.test_crash_recovery import dask_on  # noqa: F401, a fixture

pytestmark = pytest.mark.usefixtures("one_process")
SPEEDS = (0.04, 0.08, 0.06)


def write_specimens(folder, number=3, groups=(("soft", 400.0), ("hard", 800.0))):
    """Presses of specimens whose stiffness differs by group, and a little by specimen."""
    folder.mkdir(exist_ok=True)
    for treatment, stiffness in groups:
        for specimen in range(number):
            k = stiffness * (1 + 0.02 * specimen)
            write_presses(
                folder / f"s{specimen}_{treatment}.csv",
                speeds_m_s=SPEEDS,
                force_of=lambda x, v, k=k: k * x + 6.0 * v,
                seed=specimen,
            )
    return folder


@pytest.fixture(scope="module")
def specimens(tmp_path_factory):
    folder = write_specimens(tmp_path_factory.mktemp("batch") / "recordings")
    (folder / "broken.csv").write_text("this is\nno measurement\n")
    return folder


@pytest.fixture(scope="module")
def out(specimens, one_process):
    """The folder of a batch of them, without the broken one's group."""
    folder = specimens.parent / "out"
    pattern = ("--pattern", "{specimen}_{treatment}.csv", "--group", "treatment")
    assert_refused(run("batch", specimens, *pattern, "--out", folder), "broken.csv", "--pattern")
    done("batch", f"{specimens}/s*.csv", *pattern, "--out", folder, "--workers", 2)
    return folder


def rows(folder):
    with (folder / "table.csv").open() as file:
        return list(csv.DictReader(file))


def test_numbers_match_the_single_commands(specimens, out):
    row = next(row for row in rows(out) if row["measurement"] == "s1_soft.csv")
    comparison = Study(specimens / "s1_soft.csv", keep=False).compare()["contact"]
    stiffness = comparison.parameters["stiffness.k"]
    assert float(row["stiffness.k [N/m]"]) == stiffness.value
    assert float(row["stiffness.k low [N/m]"]) == stiffness.interval[0]
    assert float(row["rmse"]) == comparison.rmse
    assert float(row["noise"]) == comparison.noise.value
    assert 0.0 < float(row["excluded_share"]) < 0.2
    assert (row["group"], row["specimen"], row["treatment"]) == ("soft", "s1", "soft")
    table = pq.read_table(out / "table.parquet")
    assert table.column_names == list(row)
    assert len(table) == 6


def test_group_difference_and_specimen_variation_are_estimated(out, specimens):
    said = as_json("batch", f"{specimens}/s*.csv", "--pattern", "{specimen}_{treatment}.csv",
                   "--group", "treatment", "--out", out)  # fmt: skip
    (soft,) = (
        entry for entry in said["pooled"] if (entry["parameter"], entry["group"]) == ("stiffness.k", "soft")
    )
    true = 400.0 * (1 + 0.02 * np.arange(3))
    assert soft["effects"]["mean"] == pytest.approx(true.mean(), rel=0.01)
    assert soft["effects"]["spread"] == pytest.approx(true.std(ddof=1), rel=0.3)
    by_name = {entry["parameter"]: entry for entry in said["differences"]}
    assert by_name["stiffness.k"]["p_corrected"] < 0.001
    assert by_name["damping.c"]["p_corrected"] > 0.05
    page = (out / "index.html").read_text()
    assert "differs" in page
    assert "s1_soft.csv" in page
    assert "Nothing was diagnosed" in page
    assert "Missing effects" not in page


def test_repeated_batch_computes_only_changed_files(specimens, tmp_path):
    copy, out = tmp_path / "copy", tmp_path / "out"
    copy.mkdir()
    for name in ("s0_soft.csv", "s0_hard.csv"):
        (copy / name).write_bytes((specimens / name).read_bytes())
    done("batch", specimens / "s0_soft.csv", specimens / "s0_hard.csv", "--out", out, "--workers", 1)
    before = ResultStore(out / "results").finished()
    result = palpate.batch(copy, out=out, workers=1)
    assert result._repr_html_().startswith("<table><caption>2 of 2 measurements done, 0 unreadable")
    assert re.search(r"contact +stiffness.k +all +2 +\S+ N/m +\S+ to \S+", str(result))
    assert ResultStore(out / "results").finished() == before
    write_presses(copy / "s0_soft.csv", speeds_m_s=SPEEDS, seed=77)
    result = palpate.batch(copy, out=out, workers=1)
    assert len(ResultStore(out / "results").finished() - before) == 1
    assert (result.measurements, result.finished, len(result.table)) == (2, 2, 2)


def test_only_inapplicable_effects_are_omitted(specimens, tmp_path):
    """Backlash is an effect of joints."""
    press = specimens / "s0_soft.csv"
    palpate.batch(press, out=tmp_path, add=["backlash", "cubic_stiffness"], workers=1)
    (row,) = rows(tmp_path)
    study = Study(press, keep=False)
    alone = study.comparison(study.channels[0], ["cubic_stiffness"])
    assert float(row["cubic_stiffness.k3 [N/m^3]"]) == alone.parameters["cubic_stiffness.k3"].value
    assert "without backlash" in row["warnings"]
    assert "cubic_stiffness" not in row["warnings"]


def test_unreadable_file_is_a_row_with_its_reason(specimens, tmp_path):
    out = tmp_path / "out"
    nameless = saved(tmp_path / "nameless.csv", "a,b\n1,2\n")
    bad = tmp_path / "bad"
    refused = run("batch", nameless, specimens / "broken.csv", "--out", bad, "--workers", 1, "--json")
    assert_refused(refused, "none of 2 measurements is readable", "nameless.csv", "table.csv", "index.html")
    assert (bad / "index.html").is_file()
    reasons = {row["measurement"]: row["error"] for row in rows(bad)}
    assert "--column force_N=COLUMN" in reasons["nameless.csv"]  # as on a command line
    assert "broken.csv" in reasons["broken.csv"]
    refused = run("batch", nameless, "--out", tmp_path / "alone", "--workers", 1)
    assert_refused(refused, "nameless.csv", "--column force_N=COLUMN", "index.html")
    files = (specimens / "broken.csv", specimens / "s0_soft.csv")
    said = as_json("batch", *files, "--out", out, "--workers", 1)
    assert (said["measurements"], said["finished"]) == (2, 2)
    assert "broken.csv" in said["errors"]["broken.csv"]
    good, broken = sorted(rows(out), key=lambda row: row["error"])
    assert (good["measurement"], broken["measurement"]) == ("s0_soft.csv", "broken.csv")
    assert broken["channel"] == ""


def test_only_a_retry_computes_a_failed_row_again(specimens, tmp_path):
    """The stored rows are marked, so that a row computed again differs from one that was kept."""
    out, files = tmp_path / "out", (specimens / "broken.csv", specimens / "s0_soft.csv")
    done("batch", *files, "--out", out, "--workers", 1)
    for path in (out / "results").rglob("*.parquet"):
        table = pq.read_table(path)
        marked = [text and f"marked: {text}" for text in table["error"].to_pylist()]
        place = table.column_names.index("error")
        pq.write_table(table.set_column(place, table.field("error"), pa.array(marked)), path)
    done("batch", *files, "--out", out, "--workers", 1)
    (kept,) = (row["error"] for row in rows(out) if row["error"])
    assert kept.startswith("marked: ")
    finished = ResultStore(out / "results").finished()
    done("batch", *files, "--out", out, "--workers", 1, "--retry")
    assert (ResultStore(out / "results").finished(), len(rows(out))) == (finished, 2)
    (again,) = (row["error"] for row in rows(out) if row["error"])
    assert again == kept.removeprefix("marked: ")


def test_diagnosis_names_the_effect_and_an_added_effect_has_a_size_in_every_row(
    few_effects, hardening, tmp_path
):
    plain = write_presses(tmp_path / "plain.csv", cubic=0.0)
    said = palpate.batch([hardening, plain], out=tmp_path / "out", diagnose=True, workers=2)
    by_name = {row["measurement"]: row for row in said.table.to_pylist()}
    assert by_name["plain.csv"]["verdict"] == "adequate"
    assert by_name["hardening.csv"]["verdict"] == "missing"
    assert by_name["hardening.csv"]["effects"] == "cubic_stiffness"
    assert by_name["hardening.csv"]["budget elastic shape"] > 0.8
    assert "Missing effects" in (tmp_path / "out" / "index.html").read_text()
    added = palpate.batch([hardening, plain], out=tmp_path / "out", add=["cubic_stiffness"], workers=2)
    grown = {row["measurement"]: row["stiffness.k [N/m]"] for row in added.table.to_pylist()}
    # Of the model with the effect.
    assert by_name["hardening.csv"]["stiffness.k [N/m]"] == grown["hardening.csv"]
    sizes = {row["measurement"]: row["cubic_stiffness.k3 [N/m^3]"] for row in added.table.to_pylist()}
    assert sizes["hardening.csv"] == pytest.approx(2e6, rel=0.1)
    assert abs(sizes["plain.csv"]) < 2e5


def test_page_links_outliers_to_reports_that_are_written_once_or_to_their_command(without_figures, tmp_path):
    """Six specimens in one file, of which the last is twice as stiff."""
    tables, data, out = [], tmp_path / "all.csv", tmp_path / "out"
    for number, k in enumerate((398.0, 400.0, 401.0, 399.0, 402.0, 800.0)):
        law = lambda x, v, k=k: k * x + 6.0 * v  # noqa: E731
        press = write_presses(tmp_path / "one.csv", speeds_m_s=(0.08, 0.06), force_of=law, seed=number)
        head, *lines = press.read_text().splitlines()
        tables += [f"{line},no {number}" for line in lines]
    data.write_text("\n".join([f"{head},specimen", *tables]))
    batch = ("batch", data, "--split", "specimen", "--out", out, "--workers", 1, "--reports")
    said = as_json(*batch, 1)
    ((name, report),) = said["reports"].items()
    assert name == "all.csv specimen=no 5"
    assert f'<a href="{report}">report</a>' in (out / "index.html").read_text()
    text = (out / report).read_text()
    stiffness = re.search(r"stiffness k (\S+) ± ", " ".join(re.sub(r"<[^>]*>", " ", text).split()))[1]
    assert float(stiffness) == pytest.approx(800.0, rel=0.01)
    (out / report).write_text(f"marked {text}")
    assert as_json(*batch, 1)["reports"] == said["reports"]
    assert (out / report).read_text().startswith("marked ")
    done(*batch, 0)
    page = html.unescape((out / "index.html").read_text())
    assert report not in page
    assert f"palpate report {data} --where 'specimen=no 5'" in page


def test_report_has_the_diagnosis_and_added_effects_of_its_batch(
    few_effects, without_figures, hardening, tmp_path
):
    options = {"model": None, "diagnose": True, "add": ["bias", "backlash"], "urdf": None}
    options |= {"tip_frame": None, "effects": [], "read": NO_OPTIONS.stated()}
    write_measurement_report([hardening], {"where": {}, "options": options}, tmp_path / "report.html")
    page = " ".join(re.sub(r"<[^>]*>", " ", (tmp_path / "report.html").read_text()).split())
    assert re.search("cubic_stiffness .{0,80}is missing from the base model", page)
    assert "Added since: contact with bias" in page


def test_terminal_reports_the_number_of_inadequate_measurements_and_copies(hardening, tmp_path):
    plain, copy = write_presses(tmp_path / "plain.csv", cubic=0.0), tmp_path / "copy.csv"
    copy.write_bytes(plain.read_bytes())
    batch = ("batch", hardening, plain, copy, "--out", tmp_path / "out")
    said = " ".join(done(*batch).stdout.split())
    assert "kelvin_voigt does not fit contact in 1 of 3 measurements: errors reach" in said
    same = (
        "1 measurement has the same content as another (copy.csv, plain.csv); means and tests count each copy"
    )
    assert same in said
    pooled = as_json(*batch)["pooled"]
    low, high = next(entry["effects"]["interval"] for entry in pooled if entry["parameter"] == "stiffness.k")
    found = re.search(r"stiffness.k: mean \S+ ± (\S+) N/m \(95 %\)", said)
    assert float(found[1]) == pytest.approx((high - low) / 2, rel=0.06)


@pytest.mark.slow
def test_suggested_model_is_the_one_that_fits_far_better(tmp_path):
    for number in range(3):
        law = lambda x, v: 3e4 * x**1.5 * (1 + 2.0 * v)  # noqa: E731
        write_presses(tmp_path / f"r{number}.csv", speeds_m_s=SPEEDS, force_of=law, seed=number)
    result = palpate.batch(tmp_path, out=tmp_path / "out", model="suggest", workers=2)
    assert set(result.table["model"].to_pylist()) == {"hunt_crossley"}


def test_files_are_joined_split_listed_and_described(tmp_path, specimens):
    names = lambda found: [measurement.name for measurement in found]  # noqa: E731
    files = [f"{specimens}/s*.csv"]
    joined = find_measurements(files, pattern="{specimen}_{treatment}.csv", join="specimen")
    assert names(joined) == ["s0", "s1", "s2"]
    assert [len(each.files) for each in joined] == [2, 2, 2]
    assert joined[0].fields == {"specimen": "s0"}
    split = find_measurements([specimens / "s0_soft.csv"], split="run")
    assert [dict(each.where) for each in split] == [{"run": "0"}, {"run": "1"}, {"run": "2"}]
    sheet = specimens.parent / "list.csv"
    sheet.write_text(
        "file;arm;day\nrecordings/s0_soft.csv;left;2026-01-02\nrecordings/none.csv;right;2026-01-03\n"
    )
    listed = find_measurements([sheet])
    assert [each.fields["arm"] for each in listed] == ["left", "right"]
    sheet = saved(tmp_path / "about.csv", "specimen,animal\ns0,pig\ns1,cow\ns2,cow\n")
    described = find_measurements(files, pattern="{specimen}_{treatment}.csv", metadata=sheet)
    assert {each.fields["animal"] for each in described if each.fields["specimen"] == "s1"} == {"cow"}


def write_lerobot(folder, torques_Nm):
    """A data set of one joint: one file, and in it an episode for each Coulomb torque, in degrees and N m."""
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text("{}")
    rng, t = np.random.default_rng(5), np.arange(0.0, 8.0, 0.01)
    parts = []
    for episode, coulomb in enumerate(torques_Nm):
        q = 0.6 * np.sin(1.1 * t) + 0.3 * np.sin(2.9 * t + 1.0)
        v = 0.66 * np.cos(1.1 * t) + 0.87 * np.cos(2.9 * t + 1.0)
        a = -0.726 * np.sin(1.1 * t) - 2.523 * np.sin(2.9 * t + 1.0)
        noise = 0.01 * rng.standard_normal(len(t))
        torque = (0.05 + 0.01 * episode) * a + 0.1 * v + coulomb * np.tanh(v / 0.01) + noise
        columns = {"timestamp": t.astype(np.float32), "episode_index": np.full(len(t), episode)}
        lists = {"observation.state": np.degrees(q), "observation.effort": torque}
        columns |= {name: pa.array(values[:, None].tolist()) for name, values in lists.items()}
        parts.append(pa.table(columns))
    pq.write_table(pa.concat_tables(parts), folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


OF_JOINT = ("--unit", "position=deg", "--unit", "torque=Nm", "--add", "coulomb_friction", "--workers", 1)


def test_each_episode_of_a_lerobot_data_set_is_a_measurement_and_unlike_ones_share_no_law(tmp_path):
    torques = (0.2, 0.4, 0.3)
    folder, out = write_lerobot(tmp_path / "set", torques), tmp_path / "out"
    names = [f"file-000.parquet run={episode}" for episode in range(3)]
    assert [each.name for each in find_measurements([folder])] == names
    (file,) = folder.glob("data/**/*.parquet")
    assert [each.name for each in find_measurements([file])] == ["file-000.parquet"]  # a file is one
    batch = ("batch", folder, *OF_JOINT, "--out", out, "--share")
    said = done(*batch, "coulomb_friction").stdout
    told = {row["run"]: float(row["coulomb_friction.force [N m]"]) for row in rows(out)}
    assert told == {str(episode): pytest.approx(torque, rel=0.01) for episode, torque in enumerate(torques)}
    assert "coulomb_friction.force in 3 estimates is not shared" in " ".join(said.split())
    assert "(corrected p < 1e-15)" in " ".join(said.split())
    assert "contradicted" in (out / "index.html").read_text()
    assert_refused(run(*batch, "backlash"), "--share backlash", "Available:", "coulomb_friction")


def test_law_is_shared_where_recordings_agree(tmp_path):
    folder = write_lerobot(tmp_path / "same", (0.3,) * 3)
    same = ("batch", folder, "--model", "inertia", *OF_JOINT, "--share", "coulomb_friction")
    same = (*same, "--out", tmp_path / "out")
    (shared,) = (each for each in as_json(*same)["shared"] if each["parameter"] == "coulomb_friction.force")
    alone = [float(row["coulomb_friction.force std_err [N m]"]) for row in rows(tmp_path / "out")]
    assert not shared["contradicted"]
    assert shared["count"] == 3
    assert abs(shared["value"] - 0.3) < 4 * shared["std_err"]
    assert shared["std_err"] == pytest.approx(np.mean(alone) / 3**0.5, rel=0.1)


def test_equal_file_names_are_distinguished_and_binary_is_no_list(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_presses(tmp_path / folder / "press.csv", speeds_m_s=(0.04, 0.08))
    (tmp_path / "a" / "binary.csv").write_bytes(b"\xff\x00\x9f" * 100)
    found = find_measurements([f"{tmp_path}/*/press.csv"], split="run")
    names = ["a/press.csv run=0", "a/press.csv run=1", "b/press.csv run=0", "b/press.csv run=1"]
    assert sorted(each.name for each in found) == names
    assert [each.name for each in find_measurements([tmp_path / "a" / "binary.csv"])] == ["binary.csv"]
    (tmp_path / "list.csv").write_text("file,arm\n")
    with pytest.raises(InputError, match="no measurement found"):
        find_measurements([tmp_path / "list.csv"])


@pytest.mark.slow
def test_sessions_and_a_damaged_one_are_measurements_too(probed, tmp_path):
    (tmp_path / "whole.mcap").write_bytes(probed[0].read_bytes())
    (tmp_path / "damaged.mcap").write_bytes(probed[0].read_bytes()[:200])
    result = palpate.batch(tmp_path, out=tmp_path / "out", workers=2)
    whole = [row for row in result.table.to_pylist() if row["measurement"] == "whole.mcap"]
    assert {"contact", "joint_1"} <= {row["channel"] for row in whole}
    contact = next(row for row in whole if row["channel"] == "contact")
    stiffness = Study(probed[0], keep=False).compare()["contact"].parameters["stiffness.k"]
    assert contact["stiffness.k [N/m]"] == stiffness.value
    assert "damaged.mcap" in result.errors["damaged.mcap"]


def test_time_of_a_measurement_counts_once_for_all_channels(tmp_path):
    cells = {"measurement": list("aab"), "channel": ["joint_1", "joint_2", ""], "seconds": [2.0, 2.0, 1.0]}
    empty = {name: [""] * 3 for name in ("files", "group", "model", "verdict", "effects", "error")}
    table = pa.table(cells | empty | {"times_noise": [1.0, 1.0, None]})
    write_page(BatchResult(tmp_path, table, 2, 2, (), (), ()))
    assert "processor time</b> 3.0 s" in " ".join((tmp_path / "index.html").read_text().split())


def test_batch_stopped_before_the_first_result_continues(specimens, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "_JOIN_S", 0.2)
    press, out = specimens / "s0_soft.csv", tmp_path / "out"
    lost = run("batch", press, "--out", out, "--scheduler", "tcp://127.0.0.1:9")
    assert_refused(lost, "tcp://127.0.0.1:9")
    assert not list(out.rglob("*.csv"))
    done("batch", press, "--out", out, "--workers", 1, "--retry")
    (before,) = rows(out)
    lost = run("batch", press, "--out", out, "--scheduler", "tcp://127.0.0.1:9", "--model", "hunt_crossley")
    assert_refused(lost, "tcp://127.0.0.1:9")
    assert rows(out) == [before]  # not replaced by an empty table


def test_table_of_failures_has_their_rows(tmp_path):
    missing = BatchMeasurement("gone.csv", (str(tmp_path / "gone.csv"),))
    empty = ResultStore(tmp_path).table([])
    table = make_table([missing], [None], empty, {"gone.csv": "no such file"}, None)
    assert table.select(["measurement", "error"]).to_pylist() == [
        {"measurement": "gone.csv", "error": "no such file"}
    ]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--group", "animal"), "--group animal: no such field"),
        (("--pool",), "--pool: 1 measurement given; at least 5 are needed"),
        (("--model", "kelvin"), "kelvin_voigt"),
        (("--add", "cubic"), "cubic_stiffness"),
        (("--share", "relaxation"), "stress_relaxation"),
    ],
)
def test_invalid_settings_are_refused_before_the_first_measurement(specimens, tmp_path, options, words):
    assert_refused(run("batch", specimens / "s0_soft.csv", "--out", tmp_path / "out", *options), words)
    assert not (tmp_path / "out").exists()


def test_folder_with_other_files_is_refused(specimens):
    assert_refused(run("batch", specimens / "s0_soft.csv", "--out", specimens), "holds other files")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"places": ["nowhere"]}, "nowhere: no such file"),
        ({"places": ["x/*.csv"]}, "no such file"),
        ({"pattern": "{a}_{a}.csv"}, "use each field once"),
        ({"pattern": "{a}-{b}.csv"}, "does not match the file name s0"),
        ({"join": "animal"}, "no such field. Available: none"),
        ({"split": "animal"}, "no such column. Available: time_s"),
    ],
)
def test_incompatible_data_are_refused_in_one_line(specimens, options, words):
    with pytest.raises(InputError, match=r"^[^\n]*$") as refused:
        find_measurements(options.pop("places", [f"{specimens}/s*.csv"]), **options)
    assert words in str(refused.value)


def process(specimens, out):
    command = [sys.executable, "-m", "palpate.main", "batch", f"{specimens}/s*.csv", "--out", str(out)]
    return subprocess.Popen(
        [*command, "--workers", "2"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def numbers(folder):
    return [{name: cell for name, cell in row.items() if name != "seconds"} for row in rows(folder)]


@pytest.mark.slow
def test_scheduler_workers_give_the_same_table(specimens, out, tmp_path, dask_on):  # noqa: F811
    _, address = dask_on()
    done("batch", f"{specimens}/s*.csv", "--out", tmp_path / "out", "--scheduler", address)
    there = {row["measurement"]: row["stiffness.k [N/m]"] for row in rows(out)}
    assert {row["measurement"]: row["stiffness.k [N/m]"] for row in rows(tmp_path / "out")} == there


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_interrupted_batch_continues_to_the_same_table(tmp_path, number):
    folder = write_specimens(tmp_path / "recordings", 8)
    whole, out = tmp_path / "whole", tmp_path / "out"
    process(folder, whole).communicate(timeout=300)
    running = process(folder, out)
    until_s = time.monotonic() + 120.0
    while not (out / "results").is_dir() or len(list((out / "results").glob("[!.]*.parquet"))) < 4:
        assert time.monotonic() < until_s
        time.sleep(0.01)
    os.kill(running.pid, number)
    _, errors = running.communicate(timeout=60)
    finished = ResultStore(out / "results").finished()
    assert 4 <= len(finished) < 16
    if number != signal.SIGKILL:
        assert running.returncode == {signal.SIGINT: 130, signal.SIGTERM: 143}[number]
        assert "run the same command again to continue" in " ".join(errors.split())
        assert len(rows(out)) == len(finished)
        assert f"{len(finished)} of 16 done" in (out / "index.html").read_text()
    _, errors = process(folder, out).communicate(timeout=300)
    assert numbers(out) == numbers(whole), errors
    assert ResultStore(out / "results").finished() >= finished
    assert len(ResultStore(out / "results").finished()) == 16


def test_interrupted_pooling_reports_finished_measurements(specimens, tmp_path, monkeypatch):
    def screening_is_interrupted(cases, store, cluster, progress):
        if "screen" in cases[0].parameters["options"]:
            progress(1, len(cases))
            raise KeyboardInterrupt
        return run_cases(cases, store, cluster, progress)

    monkeypatch.setattr("palpate.batches.run.run_cases", screening_is_interrupted)
    result = run("batch", f"{specimens}/s*.csv", "--pool", "--out", tmp_path / "out", "--workers", 2)
    assert result.exit_code == 130
    assert "6 of 6 measurements are done" in result.stderr


def test_names_that_are_no_utf8_are_rows_too(tmp_path):
    good = tmp_path / os.fsdecode(b"good\xff.csv")
    write_presses(tmp_path / "press.csv", speeds_m_s=SPEEDS).rename(good)
    broken = saved(tmp_path / os.fsdecode(b"broken\xfe.csv"), "this is\nno measurement\n")
    run("batch", good, broken, "--out", tmp_path / "out", "--workers", 1)
    told = {row["measurement"]: bool(row["error"]) for row in rows(tmp_path / "out")}
    assert told == {"good?.csv": False, "broken?.csv": True}


@pytest.mark.parametrize("labels", [(1234567.5, 1234568.5), ("plate  1", "plate  2"), (7, 8.0), ("", "x")])
def test_each_part_of_a_split_file_can_be_read(tmp_path, labels):
    path = write_presses(tmp_path / "all.csv", speeds_m_s=SPEEDS, force_of=lambda x, v: 400.0 * x + 6.0 * v)
    head, *rows = path.read_text().splitlines()
    half = len(rows) // 2
    lines = [f"{row},{labels[number >= half]}" for number, row in enumerate(rows)]
    path.write_text("\n".join([f"{head},specimen", *lines]))
    parts = find_measurements([path], split="specimen")
    assert len(parts) == sum(label != "" for label in labels)
    for part in parts:
        table = read_table(path)
        (texts,) = (chosen_texts(*item, table.labels("specimen")[0], "") for item in part.where.items())
        assert len(texts) == 1


def test_hidden_files_are_no_measurements(tmp_path):
    write_specimens(tmp_path, 1)
    (tmp_path / "._s0_soft.csv").write_bytes(b"\0\5\26\7")
    assert len(find_measurements([tmp_path])) == len(data_files(tmp_path)) == 2


@pytest.mark.parametrize("quote", ['"', ""])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252"])
def test_lists_may_come_from_a_spreadsheet(tmp_path, quote, encoding):
    write_specimens(tmp_path, 1)
    names = ("file", "Härte"), ("s0_soft.csv", "weich, mürbe"), ("s0_hard.csv", "hart")
    rows = [";".join(f"{quote}{cell}{quote}" for cell in row) for row in names]
    (tmp_path / "list.csv").write_bytes("\r\n".join(rows).encode(encoding))
    listed = find_measurements([tmp_path / "list.csv"])
    described = find_measurements([*tmp_path.glob("s0*.csv")], metadata=tmp_path / "list.csv")
    for found in (listed, described):
        assert sorted(each.fields["Härte"] for each in found) == ["hart", "weich, mürbe"]


def test_list_that_names_a_file_twice_is_refused_with_both_lines(tmp_path):
    (tmp_path / "b.csv").touch()
    rows = ["file,treatment", "a.csv,x", "b.csv,x", "./b.csv,y"]
    (tmp_path / "list.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match=r"list.csv: lines 3 and 4 both name .*b.csv") as refused:
        find_measurements([tmp_path / "list.csv"])
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "argument",
    [{"pattern": 5}, {"group": 5}, {"model": 5}, {"metadata": 5}, {"urdf": 5}, {"out": 5}, {"data": 5}],
)
def test_arguments_of_a_wrong_type_are_refused_by_name(tmp_path, argument):
    (name,) = argument
    with pytest.raises(InputError, match=f"^{name}=5: give a "):
        palpate.batch(**{"data": tmp_path, "out": tmp_path / "out"} | argument)


@pytest.mark.parametrize("argument", [{"reports": -1}, {"workers": 0}])
def test_too_small_counts_are_refused_by_name(tmp_path, argument):
    ((name, number),) = argument.items()
    with pytest.raises(InputError, match=f"^{name}={number}: give a whole number"):
        palpate.batch(tmp_path, out=tmp_path / "out", **argument)
