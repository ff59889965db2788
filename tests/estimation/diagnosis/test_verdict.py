"""Verdict of a search: effects with their evidence, remaining error, and next experiment."""

import re
from dataclasses import replace
from functools import cache, partial
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.channel import JOINTS, ChannelKind
from palpate.estimation.design.next_experiment import (
    NO_VARIED_MOTION,
    can_vary,
    propose_exploring_experiment,
    propose_known_experiment,
    propose_remedial_experiment,
)
from palpate.estimation.diagnosis import diagnose, verdict
from palpate.estimation.diagnosis.forms import Form, analyze_kinds
from palpate.estimation.diagnosis.residual_checks import ResidualFinding
from palpate.estimation.diagnosis.result import ParameterValue, Verdict
from palpate.estimation.diagnosis.search import Search
from palpate.estimation.diagnosis.verdict import (
    Evidence,
    _describe_motion_error,
    decide_verdict,
    insufficient_diagnosis,
    unreached_effect,
)
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import final_solution, fit_model
from palpate.estimation.fit.intervals import estimate_parameters
from palpate.estimation.fit.measurement_noise import MeasurementNoise, NoiseSource
from palpate.estimation.kinds import Kind, separating_experiment
from palpate.estimation.model import Model
from tests.estimation.contact_data import channel
from tests.estimation.presses import NOISE_N, kelvin_voigt, session
from tests.estimation.searches import PRESS, ROTOR, SWING, measured, reached, searched
from tests.estimation.swings import DAMPING, NOISE_NM, no_torque
from tests.estimation.swings import coarse_swings as swings

BOTH = ("joint_spring", "coulomb_friction")  # the most telling first


@pytest.fixture(scope="module")
def swung():
    data = swings(1, lambda q, v, a: 0.1 * np.tanh(v / 0.02) + 6.0 * q)
    search = searched(data, "coulomb_friction", "joint_spring", "bias")
    return search, reached(search, *BOTH), measured(search)


def said(swung, *, complete, residual_finding=None, nothing=False):
    search, end, measurement = swung
    end = search.start if nothing else end
    return decide_verdict(Evidence(search, measurement, end, complete, residual_finding)), search, end


@pytest.fixture(scope="module")
def known(swung):
    """What is said without an objection; nobody may take the fits out of it."""
    return cache(partial(said, swung))


def test_effects_are_listed_in_order_with_error_decrease_and_parameters(known):
    found, search, end = known(complete=True)
    assert (found.verdict, found.complete, found.channel) == (Verdict.MISSING, True, "joint_1")
    spring, friction = found.accepted
    assert (spring.effect, friction.effect) == BOTH
    assert spring.rmse_before == found.baseline.rmse == search.start.rmse
    assert spring.rmse_after == friction.rmse_before
    assert spring.rmse_after == pytest.approx(search.without(end, "coulomb_friction").rmse, rel=1e-4)
    assert friction.rmse_after == found.final.rmse == found.remaining.rmse
    assert friction.rmse_after == pytest.approx(end.rmse, rel=1e-4)
    known = estimate_parameters(*final_solution(reached(search, *BOTH)))
    for entry in found.accepted:
        effect = EFFECTS[entry.effect]
        assert entry.parameters.keys() == {p.name for p in (*effect.gains, *effect.inner)}
        for name in ("physics", "equation", "signature"):
            assert getattr(entry, name) == getattr(effect, name)
        for name, told in entry.parameters.items():
            one = known[f"{entry.effect}.{name}"]
            assert (told.value, told.std_err) == pytest.approx((one.value, one.std_err), rel=1e-2)
            assert told.unit == one.unit
        assert entry.p_value <= 0.01
        assert entry.confused_with == []
    assert abs(spring.parameters["k"].value - 6.0) < 4.0 * spring.parameters["k"].std_err
    assert found.final.parameters.keys() == known.keys()
    assert found.baseline.parameters.keys() == SWING.gains.keys()


def test_each_effect_is_listed_once_for_any_order_in_the_model(swung):
    """A reader's effect may act before one that was added earlier."""
    search, end, measurement = swung
    spring, friction = (EFFECTS[name]() for name in BOTH)
    fits = [
        fit_model(search.data, model, {})
        for model in (SWING.with_effect(spring), SWING.with_effect(friction).with_effect(spring))
    ]
    evidence = Evidence(search, measurement, end, True, None)
    vars(evidence)["stages"] = [search.start, *fits]
    assert [entry.effect for entry in decide_verdict(evidence).accepted] == list(BOTH)


def test_no_experiment_is_proposed_without_remaining_error(known):
    found, _, end = known(complete=True)
    assert found.noise_floor == found.floor.value == pytest.approx(NOISE_NM, rel=0.1)
    assert found.remaining.times_floor == found.final.rmse / found.noise_floor
    assert found.remaining.depends_on == found.depends_on == []
    assert found.next_experiment is None
    assert (found.floor.free_air, found.floor.share_left) == (None, end.explainable_share())
    assert found.reason.endswith("with joint_spring and coulomb_friction, and only noise is left")
    assert found.effort_unit == "N m"


@pytest.mark.parametrize(
    ("ratio", "effort_nm", "left", "form"),
    [
        (1.2, 0.02, "only noise is left", Form.EXACT),
        (
            4.0,
            0.02,
            "the remaining error, 4.0 times the noise, depends on no recorded signal",
            Form.APPROXIMATE,
        ),
        (4.0, None, "only noise is left", Form.EXACT),  # a bound, but neighboring residuals show the noise
    ],
)
def test_residual_far_above_noise_is_not_called_noise(swung, ratio, effort_nm, left, form):
    search, end, measurement = swung
    evidence = Evidence(search, measurement, end, True, None)
    vars(evidence)["noise"] = MeasurementNoise(end.rmse / ratio, NoiseSource.NEIGHBORS, effort_nm, 0.0)
    diagnosis = decide_verdict(evidence)
    assert diagnosis.reason.endswith(left)
    # The friction is so small that the noise may hide a deviation from its law.
    assert [effect.form for effect in diagnosis.accepted] == [form, Form.APPROXIMATE]
    assert (diagnosis.rest.unexplained > 0.0) == (ratio > 1.5 and effort_nm is not None)
    if diagnosis.rest.unexplained:
        assert diagnosis.rest.noise == pytest.approx((evidence.noise.value / search.start.rmse) ** 2)


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"std_err": 0.5}, "1.02 to 2.98"),
        ({"std_err": None}, "not determined"),
        ({"std_err": 0.5, "at_bound": True}, "at its bound"),
    ],
)
def test_interval_is_stated_or_why_there_is_none(known, words):
    assert ParameterValue(value=2.0, unit="N", **known).interval_text == words


@pytest.mark.parametrize(
    ("share", "causes_n", "cause"),
    [
        (
            0.5,
            (0.1, 0.2),
            "rounding of the encoders causes errors of up to 0.100 N, enough to account for the 0.0500 N",
        ),
        (
            0.5,
            (0.01, 0.2),
            "smoothing of the motion causes errors of up to 0.200 N, enough to account for the 0.0500 N",
        ),
        (0.5, (0.01, 0.02), ""),
        (0.0, (0.1, 0.2), ""),
        (
            0.0,
            (0.01, 0.8),
            "smoothing of the motion causes errors of up to 0.800 N, which may be most of the error",
        ),
    ],
)
def test_errors_of_the_motion_are_named_where_they_may_cause_what_is_explainable(
    monkeypatch, share, causes_n, cause
):
    for name, error_n in zip(("encoder_step_error", "smoothing_error"), causes_n, strict=True):
        monkeypatch.setattr(verdict, name, lambda end, measurement, error_n=error_n: error_n)
    end = SimpleNamespace(
        explainable_share=lambda: share,
        flexible=SimpleNamespace(explained=100 * 0.05**2),
        problem=SimpleNamespace(used=np.ones(100, np.bool_)),
    )
    monkeypatch.setattr(verdict, "is_mostly_smoothing", lambda *_: causes_n[1] > 0.5)
    data = SimpleNamespace(kind=ChannelKind.CONTACT, effort_unit="N")
    evidence = SimpleNamespace(end=end, measurement=None, search=SimpleNamespace(data=data))
    assert _describe_motion_error(evidence).startswith(f"; {cause}" if cause else "")
    assert bool(_describe_motion_error(evidence)) is bool(cause)


def test_noise_bound_does_not_turn_a_smooth_residual_into_noise(swung):
    search, _, measurement = swung
    evidence = Evidence(search, measurement, reached(search, "joint_spring"), True, None)  # lacks a friction
    vars(evidence)["noise"] = MeasurementNoise(2.0 * evidence.end.rmse, NoiseSource.EACH_RUN, None, 0.0)
    diagnosis = decide_verdict(evidence)
    assert diagnosis.reason.endswith(
        "the remaining error may be noise, because only an upper bound of the noise is known"
    )
    assert {effect.form for effect in diagnosis.accepted} == {Form.APPROXIMATE}


def test_kind_is_replaceable_if_another_is_indistinguishable_from_its_effects(swung, monkeypatch):
    rivals = {"joint_spring": {}, "coulomb_friction": {"bias": swung[1]}}
    monkeypatch.setattr(verdict, "indistinguishable_models", lambda search, end, name, _: rivals[name])
    elastic, friction = sorted(said(swung, complete=True)[0].budget, key=lambda entry: entry.effects)[::-1]
    assert (elastic.effects, elastic.replaceable_by) == (["joint_spring"], [])
    assert (friction.effects, friction.replaceable_by) == (["coulomb_friction"], [Kind.SENSOR_STATICS])
    assert friction.experiment


@pytest.mark.parametrize(
    ("hidden", "form"),
    [("viscous", Form.APPROXIMATE), ("coulomb", Form.EXACT)],  # the library has only Coulomb's law
)
def test_form_is_not_exact_if_the_law_of_another_kind_fits_as_well(hidden, form):
    sliding = {"viscous": no_torque, "coulomb": lambda q, v, a: 0.5 * np.tanh(v / 0.02) - DAMPING * v}
    data = swings(1, sliding[hidden], rate_hz=250.0)
    pendulum = Model("pendulum", (EFFECTS["pendulum"](),))
    library = (EFFECTS["coulomb_friction"](),)
    (found,) = diagnose(data, pendulum, library, rng=np.random.default_rng(0)).channels
    assert [(effect.effect, effect.form) for effect in found.accepted] == [("coulomb_friction", form)]
    (friction,) = found.budget
    if form is Form.EXACT:
        assert (friction.replaceable_by, found.next_experiment) == ([], None)
        return
    assert friction.replaceable_by[0] is Kind.RATE_DEPENDENCE
    assert friction.necessary < 0.01 < 0.9 < friction.sufficient
    assert found.next_experiment.purpose == "tell coulomb_friction from a law of rate dependence"
    assert "a tenth of the speed" in found.next_experiment.instruction


@pytest.mark.parametrize("hum_n", [0.3, 0.0])
def test_report_states_the_amplitude_of_sensor_hum(hum_n):
    hum = np.sqrt(2.0) * hum_n
    data = session(2, lambda t, x, v, run: kelvin_voigt(x, v) + hum * np.sin(2.0 * np.pi * 7.3 * t))
    search = searched(data, "cubic_stiffness")
    told = decide_verdict(Evidence(search, measured(search), search.start, True, None))
    assert told.verdict is Verdict.ADEQUATE
    found = re.search(
        r"; a part of the noise \(0.300 N rms\) oscillates at (\S+) Hz, also in free air", told.reason
    )
    assert (float(found[1]) if found else None) == (pytest.approx(7.3, abs=0.05) if hum_n else None)


def test_remaining_error_is_reported_with_its_signals(known):
    found, _, end = known(complete=False, nothing=True)
    assert (found.verdict, found.complete, found.accepted) == (Verdict.UNEXPLAINED, False, [])
    assert found.noise_floor < 0.5 * end.rmse
    assert found.remaining.times_floor == pytest.approx(end.rmse / found.noise_floor)
    assert found.depends_on == found.remaining.depends_on == end.depends_on != []
    times = f"{end.rmse / found.noise_floor:.2g} times the noise"
    assert f"{times}, and depends on {found.depends_on[0]}" in found.reason
    assert found.next_experiment.purpose.endswith(", ".join(found.depends_on))
    assert known(complete=True, nothing=True)[0].verdict is Verdict.ADEQUATE


def test_residual_finding_states_the_error_and_noise_is_model_independent(swung, known):
    found, *_ = said(swung, complete=False, residual_finding=ResidualFinding("run 2 is off", "run"))
    assert found.verdict is Verdict.MISSING
    assert found.reason.endswith("; run 2 is off")
    assert found.depends_on == ["run"]
    assert found.next_experiment.purpose.endswith("run")
    given = {"complete": True}, {"complete": False}, {"complete": False, "nothing": True}
    told = [known(**what)[0] for what in given]
    assert len({(one.noise_floor, one.floor.source, one.floor.at_most) for one in told}) == 1


def test_single_candidates_are_ranked_by_remaining_error():
    """Screened on blocks of ten samples, of which a sketch is made; the error is that of single samples."""
    data = swings(1, lambda q, v, a: 0.1 * np.tanh(v / 0.02) + 2.0 * q, rate_hz=1000.0)
    search = searched(data, "bias", "asymmetric_friction", "coulomb_friction", "joint_spring")
    assert search.coarse is not None
    found = decide_verdict(Evidence(search, measured(search), search.start, True, None))
    names, errors = zip(*((one.effect, one.rmse_held_out) for one in found.ranking), strict=True)
    assert names[0] == "joint_spring"
    assert "bias" not in names  # hardly lowers the error
    assert len(errors) > 1
    assert list(errors) == sorted(errors)
    for one in found.ranking:
        assert one.rmse_held_out == pytest.approx(reached(search, one.effect).rmse, rel=1e-3)
        assert one.score == pytest.approx(1.0 - one.rmse_held_out / search.start.rmse)


def test_reason_states_which_criterion_the_best_effect_fails():
    """The hidden friction depends on the position, so a constant one has only a part of its form."""
    law = lambda q, v, a: 0.4 * np.tanh(v / 0.02) * (1.0 + np.cos(5.0 * q))  # noqa: E731
    search = searched(swings(1, law, rate_hz=250.0), "coulomb_friction")
    kinds = analyze_kinds(search)
    found = decide_verdict(Evidence(search, measured(search), search.start, False, None, (), kinds, kinds))
    share = r"but its form explains only \d\d % of the error that a flexible law of friction explains"
    assert re.search(f"best single effect, coulomb_friction, removes .*{share}", found.reason)


def test_best_single_effect_is_named_without_accepted_effects(swung, known):
    found, *_ = known(complete=False, nothing=True)
    share = f"{100 * found.ranking[0].score:.0f} %"
    assert found.reason.endswith(
        f"; the best single effect, joint_spring, removes {share} of the error, but does not meet the "
        "criteria for naming it"
    )
    assert "best single effect" not in known(complete=False)[0].reason
    found, *_ = said(swung, complete=True)
    fits = found.take_fits()
    assert set(fits) == {("joint_spring",), BOTH}
    assert fits[BOTH].solution.parameters["joint_spring.k"] == pytest.approx(6.0, rel=0.05)
    assert found.take_fits() == {}


@pytest.mark.parametrize(("scale", "confused"), [(0.1, ["joint_spring"]), (1.0, [])])
def test_indistinguishable_effects_are_listed_with_a_separating_experiment(scale, confused):
    """Where a sine is nearly straight, a weight and a spring are one."""
    made = swings(5)
    made = replace(made, **{n: scale * getattr(made, n) for n in ("position", "velocity", "acceleration")})
    noise = 0.1 * NOISE_NM * np.random.default_rng(0).standard_normal(len(made))
    torque = 0.05 * made.acceleration + 0.15 * made.velocity + 2.0 * np.sin(made.position) + noise
    search = searched(replace(made, effort=torque), "weight", "joint_spring", base=ROTOR)
    found = decide_verdict(Evidence(search, measured(search), reached(search, "weight"), True, None))
    (entry,) = found.accepted
    assert (entry.effect, entry.confused_with) == ("weight", confused)
    assert ("with weight (indistinguishable from joint_spring), and" in found.reason) == bool(confused)
    assert (found.next_experiment is not None) == bool(confused)
    if confused:
        assert found.next_experiment.separates == ["weight", "joint_spring"]
        assert found.next_experiment.purpose == "tell weight from joint_spring"
        assert found.no_experiment == NO_VARIED_MOTION  # the library's advice goes further


def test_fixed_motion_gets_the_effect_s_own_advice():
    data = replace(swings(5), context={"payload_effort_per_kg": np.ones(len(swings(5)))})
    found = propose_known_experiment(EFFECTS["payload"](), ["payload", "gravity_tilt"], data)
    assert found.instruction.startswith("change the posture (the motion recorded here goes")
    unknown = propose_known_experiment(EFFECTS["payload"](), ["payload", "drift"], data)
    assert unknown.instruction.startswith("move over a wider range, slowly and fast, in both directions (")
    assert not can_vary(data)


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        (["past motion"], "hold still for longer, then repeat the motion at once (the motion recorded here"),
        (["velocity", "time"], "move slower and faster ("),
        (["temperature"], "repeat the same motion at different values of temperature, each held constant"),
        ([], "move further, slowly ("),
        (["nothing that is known"], "move over a wider range"),
    ],
)
def test_next_experiment_varies_the_signal_of_the_error(signals, words):
    data = session(3)
    data = replace(data, context={"temperature": data.time_s}, recorded=frozenset({"temperature"}))
    found = propose_exploring_experiment(signals, data)
    assert found.instruction.startswith(words)
    assert found.purpose.endswith(", ".join(signals) or "nothing found yet")


def test_experiments_for_joints_name_no_device_that_a_joint_lacks():
    kinds = sorted({effect.kind for effect in EFFECTS.values() if not JOINTS.isdisjoint(effect.channels)})
    for pair in combinations(kinds, 2):
        assert not re.search(r"force sensor|\bpress\b", separating_experiment(*pair)), pair
    joints = {name: effect for name, effect in EFFECTS.items() if not JOINTS.isdisjoint(effect.channels)}
    for name, effect in joints.items():
        if not name.startswith("force_"):  # those are of arms with a force sensor
            hints = {rival: hint for rival, hint in effect.confused_with.items() if rival in joints}
            assert not re.search(r"force sensor|\bpress\b|\btouch\b", " ".join(hints.values())), (name, hints)


@pytest.mark.parametrize(
    ("kind", "reason", "words"),
    [
        ("contact", "the effort never changes; check the sensor and the column", "check the sensor and the"),
        ("contact", "indentation is 9 m; is the displacement in millimetres?", "check units and columns"),
        ("contact", "no contact: the force does not exceed the noise", "begin and end each run without load"),
        ("revolute", "the torque is noise", "move over a wider range, slowly and fast"),
        ("revolute", "only 4 different readings, 0.1 N m apart; use more", "use a finer sensor"),
        ("revolute", "only one run", "repeat the motion at least three times"),
    ],
)
def test_insufficient_data_give_a_remedial_experiment(kind, reason, words):
    assert propose_remedial_experiment(reason, ChannelKind(kind)).instruction.startswith(words)


def test_insufficient_data_give_only_a_reason():
    found = insufficient_diagnosis(session(3), "only one run")
    assert (found.verdict, found.reason, found.channel) == (Verdict.INSUFFICIENT, "only one run", "contact")
    assert (found.complete, found.accepted, found.baseline, found.effort_unit) == (None, [], None, "N")
    assert found.next_experiment.instruction.startswith("repeat the motion")


DRAWN = 0.15 * np.random.default_rng(8).standard_normal(6)
DRAWN -= DRAWN.mean()
VARIED = {
    "a gain": ("run_gain", "1", lambda t, x, v, run: (1.0 + DRAWN[run]) * kelvin_voigt(x, v)),
    "a zero": ("run_offset", "N", lambda t, x, v, run: kelvin_voigt(x, v) + 0.2 + DRAWN[run]),
    "nothing": ("", "", lambda t, x, v, run: kelvin_voigt(x, v)),
}


@pytest.mark.parametrize("name", VARIED)
def test_run_to_run_variation_is_named_with_its_spread(name):
    """Of a standard deviation of six draws, the error is a third; what all share is no difference."""
    effect, unit, law = VARIED[name]
    effects = [EFFECTS[name]() for name in ("run_gain", "run_offset", "bias")]
    data = session(8, law, runs=6)
    (diagnosis,) = diagnose(data, PRESS, effects, rng=np.random.default_rng(0)).channels
    assert diagnosis.complete
    if not effect:
        assert diagnosis.verdict is Verdict.ADEQUATE
        return
    (entry,) = diagnosis.accepted
    spread = entry.parameters["spread"]
    assert entry.effect == effect
    assert spread.value == pytest.approx(float(np.std(DRAWN, ddof=1)), rel=0.25)
    assert spread.std_err == pytest.approx(spread.value / np.sqrt(10.0))
    assert spread.unit == unit
    assert diagnosis.final.rmse == pytest.approx(NOISE_N, rel=0.15)


def test_unnamed_kind_has_no_share_of_a_named_effect():
    """Laws of the elastic shape draw the hinge at a deeper surface; something small has no name."""
    rng, run = np.random.default_rng(0), np.repeat(np.arange(3), 180)
    x = np.tile(np.linspace(0.0, 3.7e-3, 180), 3)
    depth = np.maximum(x - 2.9e-3, 0.0)
    force = 9e3 * depth * (1.0 + 150.0 * depth) + 0.03 * np.sin(x / 1e-4) * (depth > 0.0)
    force += rng.normal(0.0, 0.01, len(x))
    data = channel(force, x, np.full(len(x), 2e-5), 1.0 * np.arange(len(x)) + 100.0 * run, run=run)
    effects = [EFFECTS[name]() for name in ("contact_offset", "layered_stiffness")]
    (judged,) = diagnose(data, PRESS, effects, rng=np.random.default_rng(0)).channels
    assert not judged.complete
    (entry,) = judged.budget
    assert (entry.kind, entry.effects) == (Kind.CONTACT_GEOMETRY, ["contact_offset"])
    assert entry.share > 0.99


def test_at_most_three_candidates_are_fitted_alone():
    data = swings(1, lambda q, v, a: 0.5 * np.tanh(v / 0.02) + 6.0 * q)
    frictions = (f"{name}_friction" for name in ("coulomb", "asymmetric", "stribeck"))
    search = searched(data, *frictions, "joint_spring", "cubic_stiffness")
    evidence = Evidence(search, measured(search), search.start, complete=False, residual_finding=None)
    possible = [candidate for candidate in search.screen(search.start) if candidate.possible]
    assert len(possible) > 3
    assert len(evidence.single_effects) == 3
    assert set(evidence.single_effects) <= {candidate.effect.name for candidate in possible}


@pytest.mark.parametrize(
    ("newtons", "unsound", "name"),
    [(0.1, None, None), (0.0, None, "coulomb_friction"), (0.1, "joint_spring", "joint_spring")],
)
def test_effect_is_not_reached_without_gain_or_with_impossible_parameters(
    swung, monkeypatch, newtons, unsound, name
):
    """As where the step ends in another minimum than the search: the friction that is there stays at zero."""
    search, end, measurement = swung
    monkeypatch.setattr(Search, "is_sound", lambda search, fit, effect: effect != unsound)
    evidence = Evidence(search, measurement, end, complete=True, residual_finding=None)

    def step(fit, added):
        model = fit.model.with_effect(EFFECTS[added]())
        held = {"coulomb_friction.force": newtons} if added == "coulomb_friction" else {}
        return fit_model(search.data, replace(model, held=held), fit.values, search.good)

    monkeypatch.setattr(Evidence, "extended", lambda evidence, fit, added: step(fit, added))
    assert unreached_effect(evidence) == name
    assert unreached_effect(Evidence(search, measurement, search.start, True, None)) is None
