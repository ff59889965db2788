"""Adaptive force control on the simulated arm, with an online estimate."""

import numpy as np
import pytest

from palpate.control.laws.force_laws import HOLD_LAWS
from palpate.control.loop.task import Phase
from palpate.control.paths.excitation import Excitation
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.session import Session
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import load_scenario

pytestmark = pytest.mark.usefixtures("log_in_process")


def held(tmp_path, law, online, stiffness_n_m=1500.0, damping_n_s_m=20.0, **plan):
    """Ticks of the last run's hold."""
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
    contact = {"name": "kelvin_voigt", "stiffness_n_m": stiffness_n_m, "damping_n_s_m": damping_n_s_m}
    scenario = load_scenario({"object": {"law": contact, "surface_height_m": 0.12}})
    quick = {"speeds_m_s": (0.15,), "joint_speed_rad_s": 3.0, "settle_s": 0.0, "free_air_s": 0.05}
    plan = ProbingPlan(hold_s=0.6, hold_law=law, **quick, **plan)
    outcome = run_probing(ProbingJob(find_robot("follower"), path, plan, scenario=scenario, online=online))
    outcome.raise_for_failure()
    ticks = Session.open(path).samples("tick")
    rows = ticks["phase"] == Phase.HOLD
    return {name: ticks[name][rows] for name in ("force_n", "stiffness_n_m", "damping_n_s_m")}


@pytest.mark.parametrize(
    ("law", "stiffness_n_m"), [*((law, 4000.0) for law in HOLD_LAWS), ("force_tracking_impedance", 400.0)]
)
def test_every_law_holds_the_force_with_its_own_estimate(tmp_path, law, stiffness_n_m):
    force_n = held(tmp_path, law, "rls", stiffness_n_m)["force_n"][-300:]
    assert np.mean(force_n) == pytest.approx(10.0, abs=0.1)
    assert np.std(force_n) < 0.06


def test_excitation_makes_the_gradient_find_the_damping(tmp_path):
    """Indirect adaptive control: without excitation the hold teaches it nothing more."""
    ride = Excitation(amplitude_n=3.0, high_hz=8.0, duration_s=2.0)
    law, online = "force_tracking_impedance", "indirect_adaptive"
    still = held(tmp_path, law, online, damping_n_s_m=40.0)
    excited = held(tmp_path, law, online, damping_n_s_m=40.0, excitation=ride)
    assert abs(excited["damping_n_s_m"][-1] - 40.0) < 0.5 * abs(still["damping_n_s_m"][-1] - 40.0)
    assert excited["stiffness_n_m"][-1] == pytest.approx(1500.0, rel=0.1)


def test_force_is_held_with_a_model_reference_stiffness(tmp_path):
    found = held(tmp_path, "constant_force", "model_reference", damping_n_s_m=0.0)
    assert np.mean(found["force_n"][-300:]) == pytest.approx(10.0, abs=0.1)
    assert found["stiffness_n_m"][-1] == pytest.approx(1500.0, rel=0.15)
