"""Diagnosis of one channel from data quality to verdict, with mocked decisions."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.import_file import import_file
from palpate.estimation.diagnosis import completeness
from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.diagnosis.diagnose import _too_few_levels, diagnose, diagnose_channel
from palpate.estimation.diagnosis.result import Verdict
from palpate.estimation.diagnosis.verdict import insufficient_diagnosis
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.measurement_noise import measurement_noise
from palpate.estimation.kinds import Kind
from palpate.estimation.model import Model
from tests.estimation.contact_data import channel
from tests.estimation.searches import PRESS, SWING, searched
from tests.estimation.study.joints import joints
from tests.estimation.swings import NOISE_NM, WEIGHT, link_angles, swings

module = import_module(
    "palpate.estimation.diagnosis.diagnose"
)  # its package hands on a function of that name


@pytest.mark.parametrize(
    ("levels", "rmse", "said"),
    [
        (np.arange(4) * 0.5, 0.3, "the effort has only 4 different readings, 0.500 N m apart. The model"),
        (np.arange(4) * 0.5, 0.5, None),  # a step or more
        (np.arange(12) * 0.5, 0.3, "only 12 different readings"),
        (np.arange(13) * 0.5, 0.3, None),  # it crosses so many that they average out
        (np.arange(2) * 0.5, 0.3, "only 2 different readings"),
        (np.zeros(1), -1.0, None),
        (np.array([0.0, 0.1, 0.2, 5.0]), 0.05, "0.100 N m apart"),
    ],
)
def test_few_readings_determine_nothing_below_their_spacing(levels, rmse, said):
    effort, number = np.tile(levels, 10), np.zeros(10 * len(levels), dtype=np.int64)
    clock, still = np.arange(len(effort)) * 0.01, np.zeros(len(effort))
    data = ChannelData("joint_1", ChannelKind.REVOLUTE, clock, clock, still, still, effort, number, number)
    found = _too_few_levels(SimpleNamespace(data=data, rmse=rmse))
    assert found is None if said is None else said in found


FLOW = {  # what is true of a channel: what is answered
    "nothing is hidden": ({}, ("base", True)),
    "it is exact": ({"exact": True}, ("base", True)),
    "an effect is found": ({"found": "a"}, ("a", True)),
    "something is left": ({"found": "a", "complete": False}, ("a", False)),
    "something is left that may be rounding": ({"complete": False, "step": "coarse"}, "coarse"),
    "the same, beside an effect": ({"found": "a", "complete": False, "step": "coarse"}, "coarse"),
    "an effect that may be rounding": ({"found": "a", "step": "coarse"}, "coarse"),
    "the rounding itself": ({"found": "quantisation", "step": "coarse"}, ("quantisation", True)),
    "the same, and nothing is left": ({"step": "coarse"}, ("base", True)),
    "the best forms leave less": ({"found": "b", "forms": "a", "complete": False}, ("a", False)),
    "they leave more": ({"found": "a", "forms": "b", "complete": False}, ("a", False)),
    "an effect is found beside those accepted": (
        {"found": "a", "beside": {"a": ["a+b"]}, "complete": False},
        ("a+b", False),
    ),
    "effects are found one after the other, behind others that are not accepted": (
        {"found": "a", "beside": {"a": ["b", "c", "a+d"], "a+d": ["a+d+e"]}, "complete": False},
        ("a+d+e", False),
    ),
    "the fourth candidate is not tried": (
        {"found": "a", "beside": {"a": ["b", "c", "d", "a+e"]}, "complete": False},
        ("a", False),
    ),
    "four effects are enough": (
        {"found": "a+b+c+d", "beside": {"a+b+c+d": ["a+b+c+d+e"]}, "complete": False},
        ("a+b+c+d", False),
    ),
    "an effect in place of those accepted": (
        {"found": "a", "beside": {"a": ["b"]}, "complete": False},
        ("a", False),
    ),
    "an effect that is not needed": (
        {"found": "a", "beside": {"a": ["a+c"]}, "needless": "a+c", "complete": False},
        ("a", False),
    ),
    "only one effect bears a name": ({"beside": {"base": ["s"]}, "complete": False}, ("s", False)),
    "an effect gains nothing in the shown steps": ({"found": "a+b", "idle": {"a+b": "b"}}, ("a", True)),
    "an effect imitates another kind": ({"found": "a+b", "imitating": {"a+b": "b"}}, ("a", True)),
    "other effects explain as much without it": (
        {"found": "a+b", "imitating": {"a+b": "b"}, "excluding": {"b": "a+c"}},
        ("a+c", True),
    ),
    "one of these imitates, too": (
        {"found": "b", "imitating": {"b": "b", "c": "c"}, "excluding": {"b": "c", "c": "d"}},
        ("d", True),
    ),
    "no other effects are complete without it": (
        {"found": "a+b", "imitating": {"a+b": "b"}, "excluding": {"b": "c"}, "incomplete": "c"},
        ("a", True),
    ),
    "an effect of an incomplete model imitates": (
        {"found": "a+b", "imitating": {"a+b": "b"}, "excluding": {"b": "a+c"}, "complete": False},
        ("a", False),
    ),
    "a minimum that the shown steps miss": ({"found": "a", "missed": ("a",)}, ("a", False)),
    "it cannot say": ({"refused": "too short"}, "too short"),
}  # fmt: skip


class _Named(str):
    """A model that is its name."""

    is_exact = False


@pytest.mark.parametrize("name", FLOW)
def test_channel_is_searched_reduced_and_reported(name, monkeypatch):
    given, expected = FLOW[name]
    base = _Named("base")
    base.is_exact = given.get("exact", False)
    found = _Named(given["found"]) if "found" in given else base

    class CompletenessStub:
        def __init__(self, start, rng):
            self.measurement, self.incomplete = "readings", set()

        def leaves_smoothing(self, one):
            return False

        def residual_finding(self, one):
            return None

        def is_complete(self, one):
            is_complete = given.get("complete", True) and one != given.get("incomplete")
            return is_complete and one not in self.incomplete

    def searching(tried, is_complete, sufficient, forms):
        assert not given.get("exact")  # nothing is left to be searched for
        return tried.found

    def fitted(model, parameters):
        return model

    search = SimpleNamespace(
        start=base, coarse=None, rng=None, fitted=fitted, is_better=lambda one, other: one < other
    )
    search.found = found

    def excluding(name):
        others = SimpleNamespace(**vars(search))
        others.found = _Named(given.get("excluding", {}).get(name, "base"))
        return others

    search.excluding = excluding
    search.replace_implausible = lambda fit: fit
    beside = given.get("beside", {})
    search.screen = lambda one: [SimpleNamespace(possible=True, model=model) for model in beside.get(one, [])]
    search.is_needed = lambda before, after: after != given.get("needless")
    search.data, search.progress = swings(1, runs=2), lambda what, share: None
    search.added_effects = lambda one: [] if one == "base" else one.split("+")
    search.with_candidate = lambda option: _Named(option.model)
    search.without = lambda one, name: _Named(one.removesuffix(f"+{name}"))
    rough = given.get("forms", "base")

    stubs = {
        "reject_reason": lambda data: given.get("refused"),
        "prepare_search": lambda *_: search,
        "Completeness": CompletenessStub,
        "_is_likelier": lambda *_: False,
        "_is_reached": lambda evidence, judge: evidence.end not in given.get("missed", ()),
        "select_effects": searching,
        "analyze_kinds": lambda *_: None,
        "named_forms": lambda *_: SimpleNamespace(solution=SimpleNamespace(model=rough, parameters={})),
        "accept_forms": lambda tried, kinds, one, *_: (one, []),
        "_accept": lambda tried, one, judge, kinds: (one, []),
        "unreached_effect": lambda one: given.get("idle", {}).get(one.end),
        "imitating_effect": lambda search, end: given.get("imitating", {}).get(end),
        "form_tests": lambda *_: [],
        "_too_few_levels": lambda _: given.get("step"),
        "decide_verdict": lambda one: (one.end, one.complete),
        "insufficient_diagnosis": lambda data, reason: reason,
    }
    for what, stub in stubs.items():
        monkeypatch.setattr(module, what, stub)
    assert diagnose_channel(swings(1, runs=2), SWING, (), np.random.default_rng(0)) == expected


@pytest.mark.parametrize(("simpler_is_complete", "way"), [(True, "complete"), (False, "forms of a simpler")])
def test_simplified_model_with_residual_is_judged_by_its_forms(simpler_is_complete, way, monkeypatch):
    incomplete = set() if simpler_is_complete else {"simpler"}

    def is_complete(fit):  # the base model counts as complete until it is marked
        return fit not in incomplete

    judge = SimpleNamespace(
        measurement="readings", is_complete=is_complete, explains_each_run=is_complete, incomplete=incomplete
    )
    monkeypatch.setattr(module, "accept_effects", lambda search, fit, *_: fit)
    monkeypatch.setattr(module, "most_parsimonious", lambda *_: "simpler")
    monkeypatch.setattr(module, "form_tests", lambda partial, end: ["complete"])
    monkeypatch.setattr(
        module, "accept_forms", lambda search, partial, fit, measurement: (fit, [f"forms of a {fit}"])
    )
    search = SimpleNamespace(start="base")
    assert module._accept(search, "whole", judge, lambda: None) == ("simpler", [way])


@pytest.mark.parametrize(
    ("changes", "is_improved"),
    [
        ({}, True),
        ({"significant": False}, False),
        ({"sensible": False}, False),
        ({"exact": True}, False),
        ({"explained": True}, False),  # tests of the single effects have decided
        ({"step": 0.5}, False),  # encoder steps cause as large an error
        ({"smooth": True}, False),  # and so does the smoothing of the motion
    ],
    ids=str,
)
def test_base_model_is_incomplete_if_an_incomplete_one_is_significantly_better(
    changes, is_improved, monkeypatch
):
    """Runs that differ make the better model incomplete; the base model's error may hide the difference."""
    given = {"significant": True, "sensible": True, "exact": False, "explained": False, "step": 0.1}
    given |= {"smooth": False} | changes
    base, better, marked = Mock(is_exact=given["exact"], held_out_mean_square=1.0), Mock(), set()
    better.held_out_mean_square = 0.8
    checks = SimpleNamespace(
        measurement="readings",
        is_complete=lambda fit: fit is base and fit not in marked,
        explains_each_run=lambda fit: given["explained"],
        incomplete=marked,
    )
    search = SimpleNamespace(start=base, rng=None, is_sensible=lambda fit: given["sensible"])
    search.added_effects = lambda fit: ["a"] if fit is better else []
    test = SimpleNamespace(is_significant=given["significant"])
    monkeypatch.setattr(module, "improvement_test", lambda *_: test)
    monkeypatch.setattr(module, "encoder_step_error", lambda *_: given["step"])
    monkeypatch.setattr(module, "is_smoothing", lambda *_: given["smooth"])
    monkeypatch.setattr(module, "accept_effects", lambda *_: base)
    monkeypatch.setattr(module, "accept_forms", lambda *_: ("reduced", ["test"]))
    end = module._accept(search, better, checks, lambda: None)
    assert end == (("reduced", ["test"]) if is_improved else (base, []))
    assert marked == ({base} if is_improved else set())


@pytest.mark.parametrize(
    ("sensible", "noise", "excess", "complete"),
    [
        (True, True, None, True),
        (False, True, None, False),
        (True, False, None, False),
        (True, True, "far above noise", False),
    ],
)
def test_objection_is_dropped_where_samples_improve_as_much_by_a_clean_model(
    sensible, noise, excess, complete, monkeypatch
):
    base, whole = Mock(is_exact=False), Mock(is_exact=False)
    search = SimpleNamespace(data=swings(1, runs=2), start=base, rng=None)
    search.added_effects = lambda fit: ["a"] if fit is whole else []
    search.is_sensible = lambda fit: sensible
    monkeypatch.setattr(completeness, "measurement_noise", lambda _: None)
    judge = Completeness(Mock(training=search.data), None)
    judge.leaves_noise = lambda fit: fit is whole or noise
    monkeypatch.setattr(
        completeness, "check_residuals", lambda fit, *_, complete: None if fit is whole else "runs"
    )
    monkeypatch.setattr(module, "exceeds_noise", lambda *_: excess)
    for check in ("find_rare_events", "find_excess_error"):
        monkeypatch.setattr(completeness, check, lambda *_: None)
    for error in ("smoothing_error", "encoder_step_error"):
        monkeypatch.setattr(completeness, error, lambda *_: 0.0)
    monkeypatch.setattr(module, "accept_effects", lambda *_: base)
    monkeypatch.setattr(module, "accept_forms", lambda *_: (base, []))
    assert module._accept(search, whole, judge, lambda: None) == (base, [])
    assert judge.is_complete(base) is complete


def say_draw(data, model, effects, rng, progress=None):
    return insufficient_diagnosis(data, f"{rng.random()} {model.effects[0].name} {len(effects)}")


@pytest.fixture
def told_its_draw(monkeypatch):
    """A diagnosis that says the first number that it draws, and the model's first effect."""
    monkeypatch.setattr(module, "diagnose_channel", say_draw)


def test_channel_verdict_is_independent_of_other_channels_and_process(told_its_draw):
    one, two = joints()
    told = []

    def reasons(channels, processes=1):
        found = diagnose(
            channels,
            SWING,
            [EFFECTS["bias"]()],
            rng=np.random.default_rng(5),
            file="x.csv",
            processes=processes,
            progress=lambda *what: told.append(what),
        )
        assert (found.file, found.model) == ("x.csv", "pendulum")
        return {entry.channel: entry.reason for entry in found.channels}

    together = reasons([one, two])
    assert list(together) == ["joint_1", "joint_2"]
    assert together == reasons([one, two], 2)
    assert together == reasons([two]) | reasons(one)
    assert len({reason.split()[0] for reason in together.values()}) == 2
    assert told[:2] == [("joint_1: judging", 0.0), ("joint_2: judging", 0.0)]
    assert told[2:] == [("joint_1: insufficient", 1.0), ("joint_2: insufficient", 1.0)]


def test_each_channel_has_its_model_and_the_whole_library_is_tried_by_default(told_its_draw):
    other = Model("free", (EFFECTS["inertia"](),))
    found = diagnose(list(joints()), [SWING, other], rng=np.random.default_rng(1))
    assert found.model == "pendulum+free"
    assert [entry.reason.split()[1] for entry in found.channels] == ["pendulum", "inertia"]
    assert {entry.reason.split()[2] for entry in found.channels} == {str(len(EFFECTS))}
    assert found.channels[0].verdict is Verdict.INSUFFICIENT


def test_model_no_better_than_a_constant_is_not_complete_by_a_noise_bound(tmp_path):
    """A pulled specimen yields once, which no other part of the run predicts: the noise is only bounded."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 1000.0, 0.1)
    stretch = np.round(t * 3.6e-5 / 5e-6) * 5e-6  # one pull at one speed, read in steps of 5 um
    rise = 380.0 * np.clip(stretch / 0.0027, 0.0, 1.0)
    force = np.where(stretch < 0.003, rise, 250.0 + 15.0 * np.exp(-(stretch - 0.003) / 2e-4))
    force = np.where(stretch > 0.0348, force * np.clip((0.036 - stretch) / 0.0012, 0.0, 1.0), force)
    force += lfilter([0.3], [1.0, -0.95], rng.normal(size=t.size))
    path = tmp_path / "pull.csv"
    rows = np.column_stack([t, stretch, force])
    np.savetxt(path, rows, delimiter=",", header="time_s,displacement_m,force_N", comments="", fmt="%.6f")
    (data,) = import_file(path).channels
    search = searched(data, base=PRESS)
    assert not Completeness(search.start, search.rng).is_complete(search.start)


def test_effect_that_imitates_two_others_is_replaced():
    """Friction and play look like friction that falls with speed; beside the play, it does not fall."""
    data = swings(2)
    pull = WEIGHT * (np.sin(link_angles(data.position, 0.1)) - np.sin(data.position))
    effort = data.effort + 0.3 * np.tanh(data.velocity / 0.005) + pull
    few = [EFFECTS[name]() for name in ("coulomb_friction", "stribeck_friction", "backlash", "joint_spring")]
    (found,) = diagnose(replace(data, effort=effort), SWING, few, rng=np.random.default_rng(1)).channels
    assert {entry.effect for entry in found.accepted} == {"coulomb_friction", "backlash"}


@pytest.mark.parametrize(("runs", "seed"), [(4, 0), (1, 0), (1, 2), (1, 7)])
def test_error_that_may_all_be_noise_of_unknown_size_allows_no_verdict(runs, seed):
    """Noise that is correlated between samples may be motion, so that only an upper bound of it is known.

    A wave with a free length fits a few percent of the noise of one run.
    """
    data = swings(1)
    data = data.select(data.run < runs)
    effort = lfilter([1.0], [1.0, -0.5], np.random.default_rng(seed).normal(size=len(data)))
    few = [EFFECTS[name]() for name in ("coulomb_friction", "bias", "delay", "joint_spring")]
    (found,) = diagnose(replace(data, effort=effort), SWING, few, rng=np.random.default_rng(1)).channels
    assert found.verdict is Verdict.INSUFFICIENT
    assert "only an upper bound of the noise is known" in found.reason


@pytest.mark.parametrize(
    ("named", "rivals", "explained", "likelier"),
    [
        (["coulomb_friction"], ["run_offset"], 0.96, True),
        (["coulomb_friction"], ["run_offset"], 0.94, False),
        (["run_gain"], ["run_offset"], 0.96, False),
        (["coulomb_friction"], ["joint_spring"], 0.96, False),
    ],
)
def test_effect_of_the_drive_is_likelier_than_runs_that_differ(named, rivals, explained, likelier):
    def fit(names, held_out):
        model = SimpleNamespace(effects=names, effect=lambda name: EFFECTS[name]())
        return SimpleNamespace(solution=SimpleNamespace(model=model, held_out=held_out))

    search = SimpleNamespace(start=fit([], 2.0), added_effects=lambda fit: fit.solution.model.effects)
    assert module._is_likelier(search, fit(named, 2.0 - explained), fit(rivals, 1.0)) is likelier


def test_error_is_compared_with_a_constant_on_the_same_means():
    """A torque below the noise of a reading, but above that of a mean of ten, is more than a constant."""
    data = swings(1, rate_hz=1000.0)
    noise = np.random.default_rng(0).normal(0.0, NOISE_NM, len(data))
    search = searched(replace(data, effort=0.006 * data.effort + noise))
    fit, effort = search.start, search.start.problem.blocked.effort
    assert measurement_noise(fit).is_bound
    assert np.sqrt(fit.held_out_mean_square) < np.std(effort) < fit.rmse
    assert Completeness(search.start, search.rng).is_complete(fit)


@pytest.mark.parametrize(
    ("curvature", "verdict", "words"),
    [
        (
            0.0,
            Verdict.INSUFFICIENT,
            "no missing effect was found, but 90 samples would show only a large effect",
        ),
        (6e4, Verdict.MISSING, ""),
    ],
)
def test_short_recording_can_show_a_large_effect_but_not_an_adequate_model(curvature, verdict, words):
    run, time_s = np.repeat(np.arange(3), 30), np.tile(0.1 * np.arange(30), 3)
    x = 4e-3 * np.sin(np.pi * time_s / 2.9) - 3e-4
    v = 4e-3 * np.pi / 2.9 * np.cos(np.pi * time_s / 2.9)
    force = np.where(x > 0.0, 400.0 * x + curvature * x**2, 0.0)
    force += np.random.default_rng(3).normal(0.0, 0.02, 90)
    effects = (EFFECTS["cubic_stiffness"](), EFFECTS["bias"]())
    data = channel(force, x, v, time_s + 9.0 * run, run=run)
    told = diagnose_channel(data, PRESS, effects, np.random.default_rng(0))
    assert told.verdict is verdict
    assert words in told.reason


def test_model_that_explains_little_beside_slow_noise_is_not_adequate():
    data = swings(1)
    noise = lfilter([1.0], [1.0, -0.98], np.random.default_rng(0).normal(0.0, 0.1, len(data)))
    told = diagnose_channel(
        replace(data, effort=0.2 * data.effort + noise), SWING, (), np.random.default_rng(0)
    )
    assert told.verdict is Verdict.UNEXPLAINED
    assert "% of the variance of the effort, and only an upper bound of the noise is known" in told.reason


def test_large_offset_beside_a_small_drift_is_a_bias():
    """A zero of 0.5 N m drifts by 0.1 N m: a drift that contains the offset is not named for both."""
    data = swings(1)
    elapsed = (data.time_s - data.time_s[0]) / np.ptp(data.time_s)
    data = replace(data, effort=data.effort + 0.5 + 0.1 * elapsed)
    effects = tuple(EFFECTS[name]() for name in ("bias", "drift"))
    result = diagnose_channel(data, SWING, effects, np.random.default_rng(0))
    assert [accepted.effect for accepted in result.accepted] == ["bias"]
    assert result.budget[0].kind is Kind.SENSOR_STATICS
    assert result.final.parameters["bias.offset"].value == pytest.approx(0.55, abs=0.01)
