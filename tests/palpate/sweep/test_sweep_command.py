"""`palpate sweep`: from a file, or the paper, to figures, tables and a page; resumed, planned, refused."""

import csv
import json
import re
from dataclasses import replace

import matplotlib.image
import pytest
import yaml

from palpate.sweep import ResultStore, paper
from palpate.sweep.case import Case
from tests.palpate.cli import as_json, assert_refused, run

pytestmark = pytest.mark.slow

MINE = {
    "description": "two soft objects",
    "objects": [{"name": "kelvin_voigt", "stiffness_n_m": [500, 900], "damping_n_s_m": 20}],
    "speeds_mm_s": [[150, 90]],
    "estimators": ["lsq", {"name": "ransac", "threshold": 1e-9}],
    "repeats": 2,
    "plan": {"hold_s": 0},
}


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mine")
    (folder / "mine.yaml").write_text(yaml.safe_dump(MINE))
    return folder / "mine.yaml"


@pytest.fixture(scope="module")
def done(mine):
    """Three of the four cases, and what the command said."""
    out = mine.parent / "out"
    result = run("sweep", mine, "--out", out, "--limit", 3, "--workers", 1, "--json")
    assert result.exit_code == 0, result.stderr
    return out, json.loads(result.stdout)


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_partial_sweep_has_a_page_with_figures_and_tables(done):
    out, said = done
    assert (said["cases"], said["finished"], said["finished_now"]) == (4, 3, 3)
    page = (out / "index.html").read_text()
    assert "3 of 4" in page
    assert "raise the threshold" in page  # why an estimator had no answer
    assert not re.findall(r"https?://", page)
    assert matplotlib.image.imread(out / "figures" / "errors.png").shape[1] > 1000
    assert (out / "figures" / "errors.svg").read_text().startswith("<?xml")
    (lsq,) = table(out / "tables" / "errors.csv")
    assert lsq["estimator"] == "lsq"
    assert float(lsq["k: worst %"]) < 1.0
    rows = table(out / "tables" / "cases.csv")
    assert [row["estimator"] for row in rows] == ["lsq", "ransac (threshold 1e-09)"] * 3
    assert {row["true stiffness.k"] for row in rows} == {"500.0", "900.0"}


def test_same_command_continues_and_repeats_nothing(done, mine):
    out, _ = done
    said = as_json("sweep", mine, "--out", out, "--workers", 1)
    assert (said["finished"], said["finished_now"]) == (4, 1)
    before = ResultStore(out / "results").finished()
    assert "4 of 4 cases done: 0 in" in run("sweep", mine, "--out", out).stdout
    assert ResultStore(out / "results").finished() == before


def test_remaining_sweep_time_follows_the_measured_cost(done, mine):
    out, _ = done
    said = as_json("sweep", mine, "--out", out, "--plan", "--workers", 4)
    (cost,) = said["cpu_s_per_case"].values()
    assert said["cases"] == 4
    assert said["left_cpu_s"] == pytest.approx((4 - said["finished"]) * cost)
    assert said["left_wall_s"] == pytest.approx(said["left_cpu_s"] / 4)
    assert "measured time per case" in run("sweep", mine, "--out", out, "--plan").stdout


@pytest.mark.parametrize(
    ("arguments", "words"), [(("papr",), "Valid: paper"), (("nothing.yaml",), "no such file")]
)
def test_bad_input_is_refused_in_one_line(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("sweep", *arguments), words)


def test_interrupted_sweep_reports_its_progress(tmp_path, mine, monkeypatch):
    def interrupted(cases, store, *_):
        store.write(cases[0].address, [{"seconds": 1.0, "first": True, "error": ""}])
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.sweep.run_cases", interrupted)
    result = run("sweep", mine, "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert "1 of 4 cases are done and saved; run the same command again to continue" in result.stderr


def test_sweep_with_a_repeated_object_finishes(tmp_path):
    twice = [MINE["objects"][0] | {"stiffness_n_m": [500, 500]}]
    (tmp_path / "twice.yaml").write_text(yaml.safe_dump(MINE | {"objects": twice, "repeats": 1}))
    said = as_json("sweep", tmp_path / "twice.yaml", "--out", tmp_path / "out", "--workers", 1)
    assert said["finished"] == said["cases"]
    assert said["page"]


def test_earlier_name_still_works(done, mine):
    out, _ = done
    assert as_json("study", mine, "--out", out, "--plan")["cases"] == 4


def test_folder_with_other_files_is_left_alone(tmp_path, mine):
    (tmp_path / "thesis.txt").write_text("mine")
    assert_refused(run("sweep", mine, "--out", tmp_path), "holds other files")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.fixture
def small_paper(monkeypatch):
    """A few cases of each part of the paper's study."""
    whole = paper.paper_cases()
    grid = [case for case in whole["grid"] if case.parameters["law"]["stiffness_n_m"] == 2000]
    grid = [case for case in grid if case.parameters["law"]["damping_n_s_m"] in (0, 100) and case.seed == 1]
    noise = [
        case for case in whole["noise"] if case.parameters["noise_percent"] in (0, 10) and case.seed == 1
    ]
    settings = {"threshold": 0.01, "subset": 5, "trials": 1000}
    ransac = [case for case in whole["ransac"] if case.parameters["settings"] == settings]
    cut = {
        "ticks": whole["ticks"], "grid": grid, "clean": [whole["clean"][-1]], "noise": noise,
        "cubes": whole["cubes"][:2], "hunt_crossley": whole["hunt_crossley"][:1], "ransac": ransac,
    }  # fmt: skip
    few = {name: [short(case) for case in cases] for name, cases in cut.items()}
    monkeypatch.setattr(paper, "paper_cases", lambda: few)
    return few


def short(case: Case) -> Case:
    return replace(case, parameters=dict(case.parameters) | {"draws": min(case.parameters["draws"], 2)})


def test_paper_is_reproduced_with_its_numbers_beside_ours(tmp_path, small_paper):
    result = run("sweep", "paper", "--out", tmp_path / "paper", "--workers", 1)
    assert result.exit_code == 0, result.stderr
    tables = tmp_path / "paper" / "tables"
    beside = {row["estimator"]: row for row in table(tables / "grid_beside_paper.csv")}
    assert (beside["ransac"]["k, paper [%]"], beside["lsq"]["c, paper [%]"]) == ("6.5", "29.5")
    assert float(beside["lsq"]["k, ours [%]"]) < 1.0
    first, second = table(tables / "table_1.csv"), table(tables / "table_2.csv")
    assert [row["k, paper [N/m]"] for row in first] == ["4812.78", "7098.3"]
    lsq = next(row for row in second if row["cube"] == "A" and row["estimator"] == "lsq")
    assert lsq["k [N/m], paper"] == "5021.53"
    assert float(lsq["k [N/m], ours"]) == pytest.approx(4939.1, rel=0.02)
    (peak,) = table(tables / "dashpot_beyond_limit.csv")
    assert float(peak["c·v [N]"]) == 15.0
    assert 12 < float(peak["peak, most [N]"]) < 15.1
    page = (tmp_path / "paper" / "index.html").read_text()
    for figure in ("3a", "3b", "4a", "4b and 4c", "4d"):
        assert f"{figure}:" in page
    made = {path.name for path in (tmp_path / "paper" / "figures").iterdir()}
    assert {"fig3a_torque.png", "fig4d_noise.svg", "ransac_map.png", "hunt_crossley.svg"} <= made
