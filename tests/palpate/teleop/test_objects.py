"""Objects in teleoperation: measured, estimated, sent and rendered."""

import numpy as np
import pytest

from palpate.control.loop.tick_record import tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.messages import ContactModel
from palpate.robot_io.session import Samples
from palpate.sim_backend.scenario import load_scenario
from palpate.teleop.estimating import diagnose_object, estimate_object
from palpate.teleop.virtual_object import (
    TargetStates,
    estimate_data,
    force_law,
    summarize_estimate,
    terms_in,
    terms_of,
)
from tests.control.simulated_arms import SimulatedArm
from tests.palpate.sessions import QUICK_RUN
from tests.robot_io.link.link_parts import DOWN, estimate

FAST = QUICK_RUN.model_copy(update={"hold_s": 0.3})
TWO_SPEEDS = QUICK_RUN.model_copy(update={"speeds_m_s": (0.15, 0.1)})
NOTHING_NEAR = QUICK_RUN.model_copy(update={"search_depth_m": 0.05})
CUBIC = {"hidden": [{"effect": "cubic_stiffness", "cubic_n_m3": 4e6}]}
TRUE_DEPTHS_M = np.linspace(0.001, 0.012, 12)


def probed(scenario: dict, plan: ProbingPlan = FAST) -> Samples:
    """The ticks of a probing, as the follower keeps them."""
    arm = SimulatedArm("follower", plan, scenario)
    arm.run()
    stream = tick_stream(arm.robot.joint_count)
    return Samples.from_records(stream, np.array(arm.log.records, stream.dtype))


POWER = {"name": "hunt_crossley", "stiffness": 7000.0, "damping": 4000.0, "exponent": 1.5}


@pytest.mark.parametrize("scenario", [{}, {"object": {"law": POWER}}], ids=["kelvin_voigt", "hunt_crossley"])
def test_first_session_estimate_is_the_object(scenario):
    found, world = estimate_object(probed(scenario), 4), load_scenario(scenario)
    assert found.model[0].name == world.object.law.name
    assert (found.target, found.runs) == (4, 1)
    assert found.surface_world_m[2] == pytest.approx(0.05, abs=1e-4)
    felt, real = force_law(found.model), world.object.law
    for depth_m in TRUE_DEPTHS_M:
        for rate_m_s in (0.0, 0.1):
            assert felt(depth_m, rate_m_s, 1e-3) == pytest.approx(
                real.force_n(depth_m, rate_m_s), rel=0.03, abs=0.05
            )


def test_law_that_cannot_be_rendered_is_not_offered():
    """Relaxation draws Hunt-Crossley's exponent below 1, where the simulator has no such law."""
    law = {"name": "kelvin_voigt", "stiffness_n_m": 2000.0, "damping_n_s_m": 20.0}
    relaxing = {"effect": "stress_relaxation", "stiffness_n_m": 1500.0, "time_s": 0.2}
    found = estimate_object(probed({"object": {"law": law}, "hidden": [relaxing]}), 0)
    assert [term.name for term in found.model] == ["kelvin_voigt"]
    force_law(found.model)


def test_accepted_effect_is_rendered(few_effects):
    found = diagnose_object(probed(CUBIC, TWO_SPEEDS), 0)
    assert found.verdict == "missing"
    assert [term.name for term in found.model] == ["kelvin_voigt", "cubic_stiffness"]
    felt, real = force_law(found.model), force_law(terms_of(load_scenario(CUBIC)))
    for depth_m in TRUE_DEPTHS_M:
        assert felt(depth_m, 0.0, 1e-3) == pytest.approx(real(depth_m, 0.0, 1e-3), rel=0.02, abs=0.05)


def test_session_without_contact_has_no_estimate():
    with pytest.raises(InputError, match="nothing was touched"):
        estimate_object(probed({"object": {"surface_height_m": -0.5}}, NOTHING_NEAR), 0)


def test_law_with_memory_is_rendered_like_in_the_simulated_world():
    scenario = {"hidden": [{"effect": "stress_relaxation", "stiffness_n_m": 300.0, "time_s": 0.1}]}
    felt = force_law(terms_of(load_scenario(scenario)))
    forces_n = [felt(0.01, 0.0, 1e-3) for _ in range(1000)]
    assert forces_n[0] == pytest.approx(500.0 * 0.01 + 300.0 * 0.01, rel=0.02)
    assert forces_n[-1] == pytest.approx(500.0 * 0.01, rel=0.01)
    sent = estimate()
    assert terms_in(estimate_data(sent)) == sent.model


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ((), "no contact law"),
        ((ContactModel("rubber", (), ()),), "rubber"),
        ((ContactModel("kelvin_voigt", ("stiffness_n_m", "damping_n_s_m"), (-1.0, 0.0)),), "stiffness_n_m"),
        ((*estimate().model, ContactModel("gravity_tilt", ("pitch_rad",), (0.1,))), "does not act between"),
        ((*estimate().model, ContactModel("payload", ("mass_kg",), (1.0,))), "joint"),
    ],
)
def test_laws_that_cannot_be_rendered_are_refused(terms, words):
    with pytest.raises(InputError, match=words):
        force_law(terms)


def test_trust_summary_states_age_and_distance_of_the_estimate():
    states = TargetStates(load_scenario("default"))
    assert "a guess" in states.summary((0.0, 0.0, 0.0), float("nan"))
    states.rendered = estimate(verdict="")
    x, y, z = states.rendered.surface_world_m
    told = states.summary((x + 0.012, y, z), 4.4)
    assert told.startswith("target 0, 12 mm away, 4 s old: k 500.0 ± 1.0 N/m")
    assert told.endswith("not diagnosed")
    assert summarize_estimate(estimate()).endswith("3 runs; adequate")
    assert estimate().direction_world == DOWN
