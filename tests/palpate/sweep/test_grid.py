"""The file of a sweep: what it means, and what is refused."""

import csv

import numpy as np
import pytest
import yaml

from palpate.control.loop.task import Phase
from palpate.estimation.estimators.ransac import Ransac
from palpate.robot_io.errors import InputError
from palpate.runs.hidden_effects import SURFACE
from palpate.sweep import figures, paper
from palpate.sweep.grid import DIAGNOSE, SHIPPED, load_grid
from palpate.sweep.paper import CUBES, paper_cases
from palpate.sweep.report import cell, write_grid
from palpate.sweep.rows import BOUND, TRUE, column, estimated, parameters_of
from palpate.sweep.tasks.probing import make_estimator
from tests.files import saved
from tests.palpate.cli import ROOT

ONE = {"objects": [{"name": "kelvin_voigt", "stiffness_n_m": 500, "damping_n_s_m": 20}]}


def grid(tmp_path, **keys):
    return load_grid(saved(tmp_path / "mine.yaml", yaml.safe_dump(ONE | keys, sort_keys=False)))


def test_every_combination_is_one_case_and_each_repeat_has_its_own_seed(tmp_path):
    stiffness = {"from": 200, "to": 600, "step": 200}
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": [0, 20]}
    more = {"speeds_mm_s": [[90], [20, 10]], "noise_percent": [0, 5], "repeats": 3, "seed": 7}
    cases = list(grid(tmp_path, objects=[law, ONE["objects"][0]], **more).cases())
    assert len(cases) == (3 * 2 + 1) * 2 * 2 * 3
    assert len({case.address for case in cases}) == len(cases)
    assert [case.seed for case in cases[:: len(cases) // 3]] == [7, 8, 9]
    assert {case.parameters["law"]["stiffness_n_m"] for case in cases} == {200, 400, 600, 500}
    assert {tuple(case.parameters["plan"]["speeds_m_s"]) for case in cases} == {(0.09,), (0.02, 0.01)}


def test_range_includes_its_end_and_only_noisy_runs_are_drawn_repeatedly(tmp_path):
    law = ONE["objects"][0] | {"damping_n_s_m": {"from": 0, "to": 0.3, "step": 0.1}}
    cases = list(grid(tmp_path, objects=[law], noise_percent=[0, 5], draws=4, repeats=1).cases())
    assert [case.parameters["law"]["damping_n_s_m"] for case in cases[::2]] == [0.0, 0.1, 0.2, 0.3]
    assert {case.parameters["noise_percent"]: case.parameters["draws"] for case in cases} == {0: 1, 5: 4}


@pytest.mark.parametrize(
    ("end", "words"),
    [(0.3, []), (0.35, ["damping_n_s_m: steps of 0.1 from 0 end at 0.3 and do not reach 0.35"])],
)
def test_range_whose_steps_miss_its_end_is_pointed_out(tmp_path, end, words):
    law = ONE["objects"][0] | {"damping_n_s_m": {"from": 0, "to": end, "step": 0.1}}
    assert list(grid(tmp_path, objects=[law]).short_ranges()) == words


def test_all_estimators_are_those_that_suit_the_model(tmp_path):
    hunt_crossley = [{"name": "hunt_crossley", "stiffness": 2000, "damping": 500, "exponent": 1.5}]
    (linear, *_), (power, *_) = (grid(tmp_path, **keys).cases() for keys in ({}, {"objects": hunt_crossley}))
    assert linear.parameters["model"] == "kelvin_voigt"
    assert power.parameters["model"] == "hunt_crossley"
    assert "double_stage_rls" not in linear.parameters["estimators"]
    assert {"double_stage_rls", "robust"} <= set(power.parameters["estimators"])
    diagnosed = grid(tmp_path, diagnose=True, hidden=["none", "random"]).cases()
    assert {case.task for case in diagnosed} == {DIAGNOSE}


LONG = {"from": 0, "to": 99_999, "step": 1}


def objects(**numbers):
    return {"objects": [{"name": "kelvin_voigt", "stiffness_n_m": 500, "damping_n_s_m": 0} | numbers]}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"speed_mm_s": [[90]]}, "speed_mm_s.*did you mean 'speeds_mm_s'"),
        ({"objects": [{"name": "kelvin_voit"}]}, "kelvin_voigt"),
        (objects(stiffness_n_m=-5), "stiffness_n_m"),
        (objects(stiffness_n_m={"from": 1, "to": 2}), "step"),
        ({"objects": []}, "objects"),
        (objects(stiffness_n_m=[]), "objects: a list or range of numbers is empty"),
        (objects(stiffness_n_m={"from": 2, "to": 1, "step": 1}), "is empty"),
        (objects(stiffness_n_m={"from": 0, "to": float("inf"), "step": 1}), "finite"),
        (objects(stiffness_n_m={"from": 0, "to": 1e6, "step": 1e-9}), "1e.15 numbers"),
        (objects(stiffness_n_m={"from": 0, "to": 1e300, "step": 1e-300}), "inf numbers.*; at most 1000000"),
        (objects(stiffness_n_m=dict(LONG), damping_n_s_m=dict(LONG)), "1e.10 objects"),
        ({"speeds_mm_s": [50, 20]}, r"speeds_mm_s.*\[\[50, 20\]\] for one run.*\[\[50\], \[20\]\] for a run"),
        ({"estimators": ["lsqq"]}, "did you mean 'lsq'"),
        ({"estimators": [{"name": "ransac", "treshold": 1}]}, "treshold"),
        ({"estimators": [{"threshold": 1}]}, "no estimator"),
        ({"hidden": ["none", "stress_relaxtion"]}, r"mine.yaml line 7, hidden entry 2: .*stress_relaxation"),
        ({"hidden": [[{"effect": "bias"}]]}, r"mine.yaml line 6, hidden entry 1: .*channel: is missing"),
        ({"model": "kelvin"}, "kelvin_voigt"),
        ({"scenario": "nowhere"}, "nowhere"),
        ({"plan": {"hold": 1}}, "hold_s"),
        ({"plan": {"hold_s": 1e9}}, "the plan takes 8.33e.05 h or more"),
        ({"repeats": 0}, "repeats"),
        ({"repeats": 1_000_000, "noise_percent": [0, 1]}, "2000000 cases"),
    ],
)
def test_invalid_value_is_refused_with_its_place(tmp_path, keys, words):
    with pytest.raises(InputError, match=words):
        grid(tmp_path, **keys)


@pytest.mark.parametrize(
    ("path", "count"), [("docs/how-to/mine.yaml", 128), ("benchmarks/hundred_thousand.yaml", 100_000)]
)
def test_example_grids_have_their_stated_size(path, count):
    assert sum(1 for _ in load_grid(ROOT / path).cases()) == count


def test_a_million_cases_are_not_too_many(tmp_path):
    assert grid(tmp_path, repeats=1_000_000).repeats == 1_000_000


def test_paper_page_has_a_section_for_each_part(tmp_path, monkeypatch):
    named = [name for name in vars(paper) if name.endswith("_section")]
    for name in named:
        monkeypatch.setattr(
            paper, name, lambda *rows, name=name: paper.ReportSection(name, None, ("".join(rows),))
        )
    parts = {name: f"rows of {name};" for name in paper_cases()}
    page = paper.write_paper(tmp_path, parts, {"seed": "1"}).read_text()
    assert len(named) == 8
    assert all(f"<h3>{name}</h3>" in page for name in named)
    assert all(text in page for text in parts.values())


def test_paper_cases_match_the_paper():
    cases = paper_cases()
    first = cases["noise"][0]
    assert cases["ticks"][0].parameters == first.parameters
    assert {case.seed for part in ("ticks", "ransac") for case in cases[part]} == {first.seed}
    grid_runs = cases["grid"]
    assert {tuple(case.parameters["plan"]["speeds_m_s"]) for case in grid_runs} == {(0.15, 0.09, 0.06)}
    by_object = {}
    for case in grid_runs:
        by_object.setdefault(tuple(case.parameters["law"].values()), set()).add(case.seed)
    assert all(len(seeds) == 3 for seeds in by_object.values())
    assert {case.parameters["noise_percent"] for case in cases["noise"]} == set(range(11))
    assert {"name": "sprls", "beta": 20, "gamma": 1} in cases["noise"][0].parameters["estimators"]
    for part in ("grid", "clean", "noise", "cubes", "hunt_crossley"):
        specs = cases[part][0].parameters["estimators"]
        ransac = [spec for spec in specs if (spec if isinstance(spec, str) else spec["name"]) == "ransac"]
        assert ransac == [{"name": "ransac", "threshold": 0.01, "label": "ransac"}]
    assert make_estimator(ransac[0]) == ("ransac", Ransac(threshold=0.01))
    law = {"name": "kelvin_voigt", "stiffness_n_m": 500, "damping_n_s_m": 100}
    assert [cases["ticks"][0].parameters[key] for key in ("law", "noise_percent")] == [law, 0.0]
    of_settings = [case.parameters for case in cases["ransac"]]
    assert {repr(own["settings"]) for own in of_settings if own["noise_percent"] > 0.0} == {
        repr({"threshold": threshold, "subset": subset, "trials": trials})
        for threshold in (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
        for subset in (2, 5, 10, 20, 50)
        for trials in (1, 10, 100, 1000)
    }
    assert all((own["law"], own["draws"]) == (law, 10) for own in of_settings)
    noises = {(own["noise_percent"], own["outliers_percent"]) for own in of_settings}
    assert noises == {(0.0, 0.0), (10.0, 0.0), (0.0, 30.0)}
    assert load_grid(SHIPPED / "paper_cubes.yaml").speeds_mm_s == ((50, 20, 10),)


@pytest.mark.parametrize("cube", CUBES, ids=lambda cube: cube.name)
def test_equation_3_gives_table_1(cube):
    assert cube.stiffness_n_m == pytest.approx(cube.k_equation_3, rel=1e-4)


def test_grid_without_settings_repeats_the_paper_s_runs(tmp_path):
    found = grid(tmp_path)
    assert (found.speeds_mm_s, found.noise_std_n) == (((150.0, 90.0, 60.0),), (0.02,))
    assert [case.seed for case in found.cases()] == [1, 2, 3]


def test_estimates_and_worst_errors_are_drawn_beside_the_paper_s():
    worst = {"ransac": (1.0, 9.0), "lsq": (2.0, 3.0), "robust": (4.0, 4.0)}  # error of k and c [%]
    rows = [
        {"estimator": name, "law stiffness_n_m": k, "law damping_n_s_m": c, "seed": seed, "error": ""}
        | {TRUE + paper.K: k, paper.K: k * (1.0 + 0.01 * seed * of_k)}
        | {TRUE + paper.C: c, paper.C: c * (1.0 - 0.01 * seed * of_c) if c else 0.25 * seed}
        for name, (of_k, of_c) in worst.items()
        for k in (400.0, 200.0)
        for c in (0.0, 50.0, 100.0)
        for seed in (-1, 1)
    ]
    section = paper.grid_section(rows, rows[:1])
    best = ("lsq (our best)", None, pytest.approx(2.0), None, pytest.approx(3.0))
    assert section.tables[0].rows[-1] == best
    assert [len(table.rows) for table in section.tables] == [3, 3, 1]
    assert section.words[0].startswith("There are 12 probing runs.")
    assert section.words[-1].endswith("; lsq then estimates a c of at most 0.250 N s/m.")
    axes_of, papers = section.drawing.axes, ((6.5, 20.6), (18.4, 29.5))
    values = {
        paper.K: ("law stiffness_n_m", [400.0, 200.0]),
        paper.C: ("law damping_n_s_m", [0.0, 50.0, 100.0]),
    }
    for column_, (name, other) in enumerate(((paper.K, paper.C), (paper.C, paper.K))):
        above, below = (list(axes.get_lines()) for axes in axes_of[column_::2])
        (_, own), (key, others) = values[name], values[other]
        truths, marks = above[: len(own)], above[len(own) :]
        for value, line in zip(own, truths, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), [(min(others), value), (max(others), value)])
        for method, line in zip(("lsq", "ransac"), marks, strict=True):
            expected = [(row[key], row[name]) for row in rows if row["estimator"] == method]
            np.testing.assert_array_equal(line.get_xydata(), expected)
        *errors, ransac, lsq = below
        for (method, percent), line in zip(worst.items(), errors, strict=True):
            assert line.get_label() == method
            np.testing.assert_allclose(line.get_xydata(), [(x, percent[column_]) for x in sorted(others)])
        assert (ransac.get_ydata()[0], lsq.get_ydata()[0]) == papers[column_]
        assert axes_of[column_ + 2].get_ylabel() == f"worst error of {name[-1]} [%]"


def test_torques_of_all_joints_are_compared(monkeypatch):
    monkeypatch.setattr(paper.figures, "torques", lambda ticks: "")
    for joint in (1, 2, 3):
        row = {f"torque_{what}_{j}_nm": 1.0 for what in ("measured", "commanded") for j in (1, 2, 3)}
        apart = row | {f"torque_measured_{joint}_nm": 1.5}
        (words,) = paper.controller_section([{"run": 0} | apart] * 5 + [{"run": 1} | row] * 5).words
        assert "differ by at most 0.500 N m" in words


def test_cube_text_names_the_largest_difference_of_the_paper_s_methods():
    """Estimates off by known shares: only those of the paper's methods count, in both parameters."""

    def rows_of(cube, estimator, k_share, c_share):
        law = {"law stiffness_n_m": cube.k["ransac"], "law damping_n_s_m": cube.c["ransac"]}
        return [
            law
            | {"seed": seed, "estimator": estimator, "error": "", "peak_n": (8.0, 9.0 + seed)}
            | {paper.K: cube.k["ransac"] * k_share, paper.C: cube.c["ransac"] * c_share}
            for seed in (1, 2)
        ]

    first, second = paper.CUBES
    rows = [
        *rows_of(first, "lsq", 1.01, 0.96),
        *rows_of(first, "robust", 3.0, 0.2),  # none of the paper's
        *rows_of(second, "ransac", 0.97, 1.02),
    ]
    section = paper.cubes_section(rows)
    words = " ".join(section.words)
    assert "within 4.0 % of the truth" in words
    assert "highest measured force is 11.0 N" in words
    assert "alone needs 15.7 N" in words  # 313.81 N s/m at 0.05 m/s
    _, table_2 = section.tables
    lsq = dict(zip(table_2.columns, table_2.rows[0], strict=True))
    assert lsq["k [N/m], ours"] == pytest.approx(1.01 * lsq["k [N/m], simulated"])
    assert lsq["c [N s/m], paper"] == first.c["lsq"]


def test_rows_without_an_estimate_count_nowhere_and_numbers_are_checked():
    row = {"estimator": "lsq", "error": ""}
    assert estimated([row, {"error": ""}, row | {"problem": "slow"}, row | {"error": "too few"}]) == [row]
    row = {TRUE + name: 1.0 for name in (SURFACE, paper.K, paper.C)}
    assert parameters_of([row | {SURFACE: 1.0, paper.K: 2.0, paper.C: None}]) == [paper.K]
    np.testing.assert_array_equal(column([{"x": 1}, {"x": None}, {}], "x"), [1.0, np.nan, np.nan])
    for value in (True, "1.0"):
        with pytest.raises(InputError, match=rf"results: 'x' is '?{value}'?, which is not a number"):
            column([{"x": 1.0}, {"x": value}], "x")


def test_errors_are_drawn_in_percent():
    rows = [
        {"estimator": "lsq", "error": "", TRUE + paper.K: 200.0, paper.K: 200.0 * (1.0 + share)}
        for share in (-0.04, 0.02, 0.01)
    ]
    axes = figures.error_spread(rows).axes[0]
    drawn, middle = axes.get_lines()
    np.testing.assert_allclose(drawn.get_xdata(), [4.0, 2.0, 1.0])
    np.testing.assert_allclose(middle.get_xdata(), 2.0)
    assert "[%]" in axes.get_xlabel()


def test_noise_section_compares_mean_errors_with_their_bounds():
    known = {TRUE + paper.K: 500.0, BOUND + paper.K: 5.0, TRUE + paper.C: 100.0, BOUND + paper.C: 2.0}
    rows = [
        known
        | {"estimator": name, "noise_percent": percent, "error": "", "inlier_share": 0.25}
        | {paper.K: 500.0 * (1.0 + off), paper.C: 100.0 * (1.0 - 2.0 * off)}
        for name, times in {"lsq": 1.0, "ransac": 8.0, paper.SPRLS: 4.0, paper.SPRLS_ZERO: 1.0}.items()
        for percent in (5.0, 10.0)
        for off in (-1e-3 * times * percent, 1e-3 * times * percent)
    ]
    section = paper.noise_section(rows)
    (_, ransac, *_), (whole,) = section.tables[0].rows, section.more
    assert ransac == ("ransac", *map(pytest.approx, (8.0, 16.0, 8.0, 8.0)))  # % and multiples of the bound
    assert whole.rows[0] == ("lsq", 5.0, *map(pytest.approx, (0.5, 1.0, 0.5, 0.5, 0.797885, 1.595769)))
    words = " ".join(section.words)
    for part in ("keeps 25 %", "c are 8 and 8 times", "squares, 1.0 and 1.0.", "4.0 times the error in k"):
        assert part in words
    for axes, errors, least in zip(
        section.drawing.axes, ((0.5, 1.0), (1.0, 2.0)), (0.797885, 1.595769), strict=True
    ):
        lsq, *_, bound = axes.get_lines()
        np.testing.assert_allclose(lsq.get_xydata(), np.transpose([(5.0, 10.0), errors]))
        np.testing.assert_allclose(bound.get_xydata(), [(5.0, least), (10.0, least)], rtol=1e-5)


def test_transition_is_drawn_around_the_touch_of_the_second_run():
    ticks = [
        {"run": run, "phase": Phase.APPROACH if k < 100 else Phase.LOADING, "time_s": 2.0 + 1e-3 * k}
        | {"force_n": max(0.0, 0.1 * (k - 100))}
        | {f"torque_commanded_{joint}_nm": float(joint - run * (k >= 100)) for joint in (1, 2, 3)}
        for run in (0, 1)
        for k in range(420)
    ]
    for since_touch, torque_nm in {-4: 9.0, -3: 5.0, 4: -2.0, 5: -4.0, 19: 7.0, 20: 8.0}.items():
        ticks[100 + since_touch]["torque_commanded_1_nm"] = torque_nm  # of the first, fast run
    section = paper.transition_section(ticks)
    assert "joint 1 changes from 1.0 to 0.0 N m without overshoot" in section.words[0]
    assert "falls from 5.0 to -2.0 N m, rises to 7.0 N m for one tick" in section.words[0]
    above, below = section.drawing.axes
    since_ms = np.arange(-60.0, 200.0)
    fall_nm, force_n = np.where(since_ms < 0.0, 0.0, -1.0), np.maximum(0.0, 0.1 * since_ms)
    for line, y in (*((line, fall_nm) for line in above.get_lines()[:3]), (below.get_lines()[0], force_n)):
        np.testing.assert_allclose(line.get_xydata(), np.transpose([since_ms, y]), atol=1e-9)


def test_force_is_drawn_over_displacement_beside_the_model_and_all_peaks():
    depths_m = {Phase.APPROACH: -4e-4, Phase.LOADING: 2e-3, Phase.HOLD: 4e-3, Phase.UNLOADING: 3e-3}
    ticks = [
        {"run": run, "phase": phase, "depth_m": depth_m, "force_n": 3.0 + run}
        for run in range(3)
        for phase, depth_m in [*depths_m.items(), (Phase.APPROACH, -6e-4), (Phase.APPROACH, None)]
    ]
    row = {"law stiffness_n_m": 500.0, "law damping_n_s_m": 100.0, "seed": 1, "error": ""}
    row |= {"speeds_mm_s": "150, 90, 60", "peak_n": (12.0, 10.0, 9.0), "over_limit_ms": (7.0, 0.0, 0.0)}
    section = paper.force_section(ticks, [row, row])  # one for each estimator
    assert section.tables[0].rows == (tuple(map(pytest.approx, (100.0, 150.0, 15.0, 12.0, 12.0, 7.0))),)
    assert "in 1 of 3 runs. Their peaks reach 12.0 N and exceed 10.5 N for at most 7 ms" in section.words[1]
    by_depth, by_jump = section.drawing.axes
    left, right = by_depth.get_lines(), by_jump.get_lines()
    for run, speed_mm_s in enumerate((150, 90, 60)):
        measured, model = left[2 * run : 2 * run + 2]
        np.testing.assert_allclose(measured.get_xydata(), [(mm, 3.0 + run) for mm in (-0.4, 2.0, 4.0)])
        touch_n = 0.1 * speed_mm_s  # 100 N s/m; and 0.5 N/mm
        np.testing.assert_allclose(model.get_xydata(), [(0.0, touch_n), (4.0, touch_n + 2.0)])
    peaks = [line.get_xydata()[0] for line in right[:3]]
    np.testing.assert_allclose(peaks, [(15.0, 12.0), (9.0, 10.0), (6.0, 9.0)])


def test_torques_of_the_first_run_are_drawn_from_its_start():
    phases = [Phase.APPROACH, Phase.LOADING, Phase.HOLD, Phase.RETRACT]
    ticks = [
        {"run": run, "phase": phase, "time_s": 5.0 + 10.0 * run + 0.1 * k}
        | {f"torque_measured_{joint}_nm": run + 10.0 * joint + k for joint in (1, 2, 3)}
        | {f"torque_commanded_{joint}_nm": run + 20.0 * joint + k for joint in (1, 2, 3)}
        for run in (0, 1)
        for k, phase in enumerate(phases)
    ]
    drawn = figures.torques(ticks).axes
    assert [axes.get_legend() is not None for axes in drawn] == [True, False, False]
    for joint, axes in enumerate(drawn, 1):
        for line, nm in zip(axes.get_lines(), (10.0 * joint, 20.0 * joint), strict=True):
            np.testing.assert_allclose(line.get_xydata(), [[0.1 * k, nm + k] for k in range(4)], atol=1e-9)
            low, high = axes.get_ylim()
            assert low < line.get_ydata().min() < line.get_ydata().max() < high
        (contact,) = axes.patches
        assert (contact.get_x(), contact.get_x() + contact.get_width()) == pytest.approx((0.1, 0.2))


def test_hunt_crossley_errors_are_drawn_with_their_bounds():
    law = {"estimator": "robust", "error": "", "law exponent": 1.5}
    estimates = {"law.k": 102.0, "law.b": 49.0, "law.n": 1.0}
    true = {TRUE + name: value for name, value in zip(estimates, (100.0, 50.0, 1.0), strict=True)}
    bounds = {BOUND + name: value for name, value in zip(estimates, (3.0, 1.0, 0.01), strict=True)}
    rows = [
        law | estimates | true | bounds | {"law stiffness": k, "law damping": k * 10**-0.5}
        for k in (2000.0, 500.0)
    ]
    section = paper.hunt_crossley_section([*rows, rows[0] | {"estimator": "lsq", "law.k": 97.0}])
    assert section.words[0].startswith("2 objects, F = ")
    assert "The error of robust in k is at most 2 %" in section.words[0]
    drawn = section.drawing.axes
    expected = {"k": (2.0, -1.0, 5.0), "b": (-2.0, -4.0, 0.0), "n": (0.0, -1.0, 1.0)}  # error and its bar [%]
    for axes, (name, (error, low, high)) in zip(drawn, expected.items(), strict=True):
        assert [bar.get_label() for bar in axes.containers] == ["k = 500", "k = 2000"]
        for points, _, (bars,) in axes.containers:
            np.testing.assert_allclose(points.get_xydata(), [[1.5, error]], atol=1e-9)
            np.testing.assert_allclose(bars.get_segments()[0], [[1.5, low], [1.5, high]], atol=1e-9)
        assert axes.get_ylabel() == f"error of {name} [%]"


def test_ransac_map_states_each_error_at_its_settings():
    settings = [(subset, 1000) for subset in (9, 5)] + [(5, 100)]
    keys = ("noise_percent", "outliers_percent", "threshold", "subset", "trials")
    rows = [
        dict(zip(keys, (*noise, threshold, *setting), strict=True))
        | {"k_over_bound": k, "c_over_bound": 9.0 if k < 5.0 else 1.0, "inlier_share": 0.5, "error": ""}
        for noise in paper.RANSAC_NOISES
        for setting, pair in zip(settings, ((1.51, 9.94), (8.5, 10.6), (999.0, 1234.0)), strict=True)
        for threshold, k in zip((0.1, 0.01), pair, strict=True)
    ]
    section = paper.ransac_section([*rows, rows[0] | {"error": "no touch"}])
    for best, papers in zip(section.tables[0].rows[::2], section.tables[0].rows[1::2], strict=True):
        assert best[1:] == (0.1, 5, 1000, 8.5, 1.0)  # the smallest sum of both
        assert papers[1:] == (0.01, 5, 1000, 10.6, 1.0)
    assert len(section.more[0].rows) == len(rows) + 1
    above, _, _, below, *_ = section.drawing.axes
    for axes, shown, heights in (
        (above, [["11", "8.5"], ["9.9", "1.5"]], ["5", "9"]),  # from below: subsets of 5, and of 9
        (below, [[">999", "999"], ["11", "8.5"]], ["100", "1000"]),
    ):
        np.testing.assert_array_equal(np.reshape([text.get_text() for text in axes.texts], (2, 2)), shown)
        assert [label.get_text() for label in axes.get_yticklabels()] == heights


def made_up(estimator, k, percent=0.0, **more):
    condition = {"law": "kelvin_voigt", "speeds_mm_s": "90", "noise_std_n": 0.02, "noise_percent": percent}
    known = {TRUE + paper.K: 500.0, BOUND + paper.K: 1.0, paper.K: k, "hidden": "none", "seconds": 1.0}
    return condition | known | {"estimator": estimator, "problem": "", "error": ""} | more


def reported(folder, grid_file, rows):
    """Text of the page, and the tables by name."""
    page = write_grid(folder, "A sweep", grid_file, rows, {"cases": "4"})
    tables = {path.stem: list(csv.reader(path.open())) for path in (folder / "tables").iterdir()}
    return page.read_text(), tables


def test_report_has_errors_by_condition_and_the_reasons_of_missing_results(tmp_path):
    rows = [made_up("lsq", 505.0), made_up("lsq", 490.0, 5.0), made_up("lsq", 490.0, 5.0)]
    lost = made_up("ransac", None, problem="no two agree")
    page, tables = reported(tmp_path / "out", grid(tmp_path), [*rows, lost, {"error": "no touch"}])
    assert [(name, line[:3]) for name in ("errors", "errors_1", "errors_2") for line in tables[name][1:]] == [
        ("errors", ["lsq", "2.0", "1.6666666666666667"]),
        ("errors_1", ["lsq", "1.0", "1.0"]),
        ("errors_2", ["lsq", "2.0", "2.0"]),
    ]
    assert tables["failures"][1:] == [["ransac: no two agree", "1"], ["no touch", "1"]]
    heads, *lines = tables["cases"]
    assert len(lines) == 5
    assert {"seconds", "error"}.isdisjoint(heads)
    assert [line[heads.index(paper.K)] for line in lines] == ["505.0", "490.0", "490.0", "", ""]
    for part in ("Errors by estimator", "Cramér-Rao", "By condition", "noise 0.02 N and 5 %", "no touch"):
        assert part in page
    assert {path.name for path in (tmp_path / "out" / "figures").iterdir()} == {"errors.svg", "errors.png"}
    page, tables = reported(tmp_path / "few", grid(tmp_path), rows[1:])  # one condition, and all is well
    assert set(tables) == {"errors", "cases"}
    assert "By condition" not in page
    assert "without a result" not in page


def test_report_of_diagnoses_counts_their_verdicts(tmp_path):
    said = {"truth": "none", "channel": "contact", "accepted": "", "error": ""}
    rows = [said | {"verdict": verdict} for verdict in ("nothing", "missing", "nothing")]
    page, tables = reported(tmp_path / "out", grid(tmp_path, diagnose=True), rows)
    assert [line[3:] for line in tables["verdicts"][1:]] == [["missing", "", "1"], ["nothing", "", "2"]]
    assert len(tables["cases"]) == 1 + 3
    assert "What the diagnosis said" in page


def test_report_of_diagnoses_states_where_each_effect_was_hidden(tmp_path):
    said = {"truth": "coulomb_friction", "channel": "joint_1", "verdict": "missing", "error": ""}
    rows = [
        said | {"truth_channel": "joint_1", "accepted": "coulomb_friction"},
        said | {"truth_channel": "joint_2", "accepted": ""},
    ]
    _, tables = reported(tmp_path / "out", grid(tmp_path, diagnose=True), rows)
    assert [line[:3] for line in tables["verdicts"]] == [
        ["hidden", "hidden in", "channel"],
        ["coulomb_friction", "joint_1", "joint_1"],
        ["coulomb_friction", "joint_2", "joint_1"],
    ]
    assert {line[tables["cases"][0].index("truth_channel")] for line in tables["cases"][1:]} == {
        "joint_1",
        "joint_2",
    }


def test_cells_have_three_digits_or_whole_numbers():
    values = (None, float("nan"), 0.0, 12, "x", -0.001234, 1.2345e-4, 5.678, 999.4, 999.5, 12345.6, 123456.0)
    shown = "– – 0 12 x -0.00123 0.00012 5.68 999 1000 12346 1.2e+05"
    assert [cell(value) for value in values] == shown.split()
