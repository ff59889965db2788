"""What the cases of a sweep work out: the arm's ticks, estimates, bounds, and what RANSAC's settings do."""

from collections import Counter
from importlib import import_module
from multiprocessing import current_process

import numpy as np
import pytest

from palpate.control.loop.task import Phase
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.diagnosis.verdict import insufficient_diagnosis
from palpate.estimation.estimators.ransac import Ransac
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.session import Session
from palpate.runs.probing import ProbingJob, probe_in_memory, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import Scenario
from palpate.sweep.tasks import probing
from palpate.sweep.tasks.probing import ransac_errors

diagnosis = import_module("palpate.estimation.diagnosis.diagnose")  # its package has a function of that name
LAW = {"name": "kelvin_voigt", "stiffness_n_m": 800.0, "damping_n_s_m": 30.0}
PARAMETERS = {
    "robot": "follower", "scenario": "default", "law": LAW,
    "plan": {"speeds_m_s": [0.15, 0.09], "hold_s": 0.0, "free_air_s": 0.1, "settle_s": 0.05},
    "noise_std_n": 0.02, "noise_percent": 0.0, "hidden": "none", "draws": 1, "model": "kelvin_voigt",
    "estimators": ["lsq", "robust", {"name": "ransac", "threshold": 0.1}, "indirect_adaptive"],
}  # fmt: skip
TIMINGS = {"read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s", "lateness_s"}


def test_ticks_in_memory_equal_those_of_a_session(tmp_path, log_in_process):
    plan = ProbingPlan(speeds_m_s=(0.15,), hold_s=0.02, free_air_s=0.1, settle_s=0.05)
    robot = find_robot("follower")
    kept = probe_in_memory(robot, Scenario(), plan)
    run_probing(ProbingJob(robot, tmp_path / "a.mcap", plan, scenario=Scenario(), online=None))
    session = Session.open(tmp_path / "a.mcap").samples("tick")
    assert len(kept) == len(session)
    for column in set(kept) - TIMINGS:
        np.testing.assert_array_equal(kept[column], session[column], err_msg=column)


def test_different_worlds_have_their_own_noise(monkeypatch):
    """With one noise for all objects of a grid, their errors would be one and the same."""
    monkeypatch.setattr(probing, "probe_in_memory", lambda robot, scenario, plan: None)
    probing._probe.cache_clear()
    stiffer = PARAMETERS | {"law": LAW | {"stiffness_n_m": 801.0}}
    worlds = [(PARAMETERS, 1), (PARAMETERS, 2), (stiffer, 1), (PARAMETERS | {"noise_std_n": 0.03}, 1)]
    seeds = [probing.probe(parameters, seed)[1].seed for parameters, seed in worlds]
    probing._probe.cache_clear()
    assert len(set(seeds)) == len(worlds)
    again = [PARAMETERS, *(PARAMETERS | {"engine": name} for name in ("pybullet", "mujoco"))]
    assert {probing.probe(parameters, 1)[1].seed for parameters in again} == {seeds[0]}
    probing._probe.cache_clear()


def test_every_estimator_has_a_row_near_the_truth_with_its_bound():
    rows = probing.estimate(PARAMETERS, 1)
    names = [row["estimator"] for row in rows]
    assert names == ["lsq", "robust", "ransac (threshold 0.1)", "indirect_adaptive"]
    for row in rows:
        assert row["stiffness.k"] == pytest.approx(800, rel=0.02)
        assert row["true stiffness.k"] == 800
    noisy = PARAMETERS | {"estimators": ["robust"], "noise_percent": 5.0, "draws": 8}
    errors = [(row["stiffness.k"] - 800) / row["bound stiffness.k"] for row in probing.estimate(noisy, 1)]
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2.5  # of an estimator that is nearly efficient


def test_contact_estimator_of_a_power_law_returns_its_exponent_and_a_law_without_truth_no_bound():
    law = {"name": "hunt_crossley", "stiffness": 3000.0, "damping": 1000.0, "exponent": 1.3}
    power = PARAMETERS | {"law": law, "model": "hunt_crossley", "estimators": ["double_stage_rls"]}
    (row,) = probing.estimate(power, 1)
    assert row["hunt_crossley.n"] == pytest.approx(1.3, rel=0.15)
    assert row["bound hunt_crossley.n"] > 0.0
    (row,) = probing.estimate(PARAMETERS | {"model": "hunt_crossley", "estimators": ["lsq"]}, 1)
    assert not [name for name in row if name.startswith("bound")]
    assert row["hunt_crossley.n"] == pytest.approx(1.0, abs=0.2)


def test_ticks_have_the_depth_that_explains_their_force():
    rows = probing.ticks(PARAMETERS, 1)
    samples, _ = probing.probe(PARAMETERS, 1)
    assert [row["torque_commanded_3_nm"] for row in rows] == samples.vector("torque_commanded_nm")[
        :, 2
    ].tolist()
    assert [row["torque_measured_1_nm"] for row in rows] == samples.vector("torque_measured_nm")[
        :, 0
    ].tolist()
    loading = [row for row in rows if row["phase"] == Phase.LOADING and row["depth_m"] > 1e-3]
    names = ("depth_m", "time_s", "force_n", "run")
    depth_m, time_s, force_n, run = np.transpose([[row[name] for name in names] for row in loading])
    for number in (0, 1):
        own = run == number
        speed_m_s = np.gradient(depth_m[own], time_s[own])
        columns = np.column_stack([depth_m[own], speed_m_s, np.ones(own.sum())])
        (k, c, _), *_ = np.linalg.lstsq(columns, force_n[own], rcond=None)
        assert (k, c) == (pytest.approx(800.0, rel=0.05), pytest.approx(30.0, rel=0.3))


def test_bound_follows_the_noise_whose_draws_repeat_for_equal_seeds():
    calm, loud = (
        probing.estimate(PARAMETERS | {"noise_percent": percent, "estimators": ["lsq"]}, 1)[0]
        for percent in (5, 10)
    )
    assert loud["bound damping.c"] == pytest.approx(2 * calm["bound damping.c"], rel=0.1)
    noisy = PARAMETERS | {"noise_percent": 5.0, "draws": 3, "estimators": ["lsq"]}
    found, again = ([row["stiffness.k"] for row in probing.estimate(noisy, 1)] for _ in range(2))
    assert len(set(found)) == 3
    assert found == again


def test_failing_estimator_states_its_reason_and_the_others_remain():
    hopeless = {"name": "ransac", "threshold": 1e-9}
    lost, kept = probing.estimate(PARAMETERS | {"estimators": [hopeless, "lsq"]}, 1)
    assert "raise the threshold" in lost["problem"]
    assert "stiffness.k" not in lost
    assert kept["problem"] == ""


def test_ransac_threshold_below_the_noise_loses_accuracy():
    def k_over_bound(threshold, outliers):
        settings = {"threshold": threshold, "subset": 5, "trials": 100}
        more = {"settings": settings, "outliers_percent": outliers, "draws": 10}
        (row,) = ransac_errors(PARAMETERS | more, 1)
        return row["k_over_bound"]

    assert k_over_bound(0.1, 0) < 1.6 < k_over_bound(0.003, 0)
    assert k_over_bound(0.1, 30) < 2.0 < k_over_bound(3.0, 30)


def test_draws_without_ransac_result_count_with_the_whole_gain_and_no_inliers(monkeypatch):
    def estimated(failing):
        draws = iter(range(4))
        fit = Ransac.fit

        def some(self, problem, **options):
            if next(draws) in failing:
                raise InputError("hardly any two samples agree")
            return fit(self, problem, **options)

        settings = {"threshold": 0.1, "subset": 5, "trials": 100}
        with monkeypatch.context() as patched:
            patched.setattr(Ransac, "fit", some)
            (row,) = ransac_errors(PARAMETERS | {"settings": settings, "outliers_percent": 0, "draws": 4}, 1)
        return row

    none, half, every = estimated(()), estimated((0, 2)), estimated((0, 1, 2, 3))
    assert every["inlier_share"] == 0.0
    assert 0.4 * none["inlier_share"] < half["inlier_share"] < 0.6 * none["inlier_share"]
    for name in ("k_over_bound", "c_over_bound"):  # root mean squares: beside a whole gain the others vanish
        assert half[name] == pytest.approx(every[name] / np.sqrt(2.0), rel=0.01)
        assert every[name] > 20.0 * none[name]


def test_run_without_contact_is_an_error():
    plan = PARAMETERS["plan"] | {"search_depth_m": 0.05}
    with pytest.raises(PalpateError, match="no touch"):
        probing.estimate(PARAMETERS | {"plan": plan}, 1)


def test_run_with_too_short_a_contact_is_an_error(monkeypatch):
    monkeypatch.setattr(probing, "contact_channels", lambda samples, *, tared: [])
    with pytest.raises(InputError, match="nothing was touched, or only for too short a time"):
        probing._contact_channel(None)


@pytest.mark.parametrize(
    ("stiffness", "damping"), [(200.0, 10.0), (200.0, 100.0), (2000.0, 10.0), (2000.0, 100.0)]
)
def test_engines_give_the_same_objects_at_the_corners_of_the_grid_of_the_paper(stiffness, damping):
    pytest.importorskip("pybullet")
    law = LAW | {"stiffness_n_m": stiffness, "damping_n_s_m": damping}
    quick = PARAMETERS | {"law": law, "estimators": ["lsq"]}
    (bullet,), (mujoco,) = (probing.estimate(quick | {"engine": name}, 1) for name in ("pybullet", "mujoco"))
    assert mujoco["stiffness.k"] == pytest.approx(bullet["stiffness.k"], rel=1e-3)
    assert mujoco["damping.c"] == pytest.approx(bullet["damping.c"], rel=1e-2)


def test_dashpot_alone_exceeds_the_limit_and_another_engine_has_the_same_noise():
    law = LAW | {"stiffness_n_m": 500.0, "damping_n_s_m": 100.0}
    quick = PARAMETERS | {"law": law, "estimators": ["lsq"]}

    def probed(engine):
        samples, scenario = probing.probe(quick | {"engine": engine}, 1)
        assert scenario.physics.engine == engine
        (row,) = probing.estimate(quick | {"engine": engine}, 1)
        return samples["force_n"][samples["phase"] == Phase.FREE_AIR][:90], row

    noise_n, row = probed("mujoco")
    fast, slow = row["peak_n"]
    assert 12 < fast < 15.1  # c v = 15 N
    assert slow < 10.5
    assert row["over_limit_ms"][0] > 0 == row["over_limit_ms"][1]
    pytest.importorskip("pybullet")
    np.testing.assert_array_equal(noise_n, probed("pybullet")[0])  # nothing but noise in free air


def test_diagnosis_in_a_daemonic_worker_identifies_hidden_effects(few_effects, monkeypatch):
    """The joints need no diagnosis here: that each has a row is enough."""
    judge = diagnosis.diagnose_channel

    def judge_contact(data, *given, **options):
        if data.name == "contact":
            return judge(data, *given, **options)
        return insufficient_diagnosis(data, "not judged")

    monkeypatch.setattr(diagnosis, "diagnose_channel", judge_contact)
    monkeypatch.setitem(current_process()._config, "daemon", True)
    hidden = [{"effect": "cubic_stiffness", "cubic_n_m3": 2e6}]
    plan = PARAMETERS["plan"] | {"speeds_m_s": [0.15, 0.12]}
    rows = probing.diagnose(PARAMETERS | {"hidden": hidden, "plan": plan}, 1)
    contact = next(row for row in rows if row["channel"] == "contact")
    assert contact["verdict"] == "missing"
    assert (contact["truth"], contact["truth_channel"]) == ("cubic_stiffness", "contact")
    assert Counter(row["channel"] for row in rows) == Counter(["contact", "joint_1", "joint_2", "joint_3"])
