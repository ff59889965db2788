"""A load cell whose zero is off, from the probing to the table."""

import json
import re

import numpy as np
import pytest

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.study.source import open_source
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.scenario import load_scenario
from tests.log_in_process import LogInProcess
from tests.palpate.cli import run

BIAS_N = 0.5


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("tare") / "a.mcap"
    hidden = [IMPERFECTIONS["bias"](channel="contact", bias=BIAS_N)]
    plan = ProbingPlan(speeds_m_s=(0.15, 0.06), hold_s=0.2)
    scenario = load_scenario("default").with_hidden(hidden)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.runs.session.SessionWriter", LogInProcess)
        run_probing(ProbingJob(find_robot("follower"), path, plan, scenario=scenario, seed=3, online=None))
    return path


def test_the_estimate_and_the_table_take_the_zero_off_but_not_for_who_looks_for_a_bias(session):
    result = run("estimate", session, "--estimator", "lsq", "--json")
    (channel,) = json.loads(result.stdout)["channels"]
    assert [tare["effort"] for tare in channel["tare"]] == pytest.approx([BIAS_N, BIAS_N], abs=0.01)
    (estimate,) = channel["estimates"]
    surface, stiffness = estimate["surface"], estimate["parameters"]["stiffness.k"]
    assert abs(surface["position_m"] + 0.05) < 4 * surface["std_err_m"] < 1e-4
    assert abs(stiffness["value"] - stiffness["truth"]) < 4 * stiffness["std_err"]
    shown = " ".join(run("estimate", session, "--estimator", "lsq").stdout.split())
    assert re.search(r"the force in free air, 0\.(50|49)\d+ N, was subtracted", shown)
    channel = open_source(session).channels[0]
    assert channel.tare is None
    assert np.mean(channel.effort[:100]) == pytest.approx(BIAS_N, abs=0.01)
