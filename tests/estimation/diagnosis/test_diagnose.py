"""What is hidden in simulated data is found, what the library lacks is not called by another's name."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.channel import ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.diagnosis.candidates import candidates, library
from estimation.diagnosis.next_experiment import exploring, sufficient
from estimation.effects import EFFECTS
from estimation.model import Model
from estimation.models import MODELS
from tests.estimation.presses import NOISE_N, K, kelvin_voigt, maxwell, session
from tests.estimation.swings import DAMPING, INERTIA, NOISE_NM, WEIGHT, read, swings

PRESS, SWING = (MODELS[name]().build(ModelContext()) for name in ("kelvin_voigt", "pendulum"))


def pressed(seed, extra=lambda t, x, v, run: 0.0, **more):
    """Presses onto a spring and damper with an `extra` force, which can only push as a whole."""
    return session(seed, lambda t, x, v, run: kelvin_voigt(x, v, extra(t, x, v, run)), **more)


# What is tried where the whole library would only take time: the effects in question and what they are
# confused with.
SOME = {
    "contact": ("cubic_stiffness", "layered_stiffness", "bias", "stress_relaxation", "contact_offset", "lag"),
    "joint_1": (
        "coulomb_friction",
        "quadratic_friction",
        "joint_spring",
        "cubic_stiffness",
        "torque_ripple",
        "backlash",
        "delay",
        "bias",
    ),
}
ALL = {"a friction", "white noise", "a coarse encoder"}  # tried with all effects


def model_of(data):
    return PRESS if data.name == "contact" else SWING


def answer(data, *names, seed=1):
    """Diagnosis with some effects, or all."""
    effects = [EFFECTS[name]() for name in names] or None
    return diagnose(data, model_of(data), effects, rng=np.random.default_rng(seed)).channels[0]


def named(found):
    return {entry.effect for entry in found.accepted}


def cubic(t, x, v, run):
    return 1.5e6 * np.maximum(x, 0.0) ** 3


def relaxing(t, x, v, run):
    return 300.0 * maxwell(t, x, run, 0.4)


def rubbing(q, v, a):
    return 0.3 * np.tanh(v / 0.01)


def late(torque, run):
    """Twelve samples late; before that, the first value."""
    parts = (torque[run == number] for number in np.unique(run))
    return np.concatenate([np.concatenate([np.repeat(part[:1], 12), part[:-12]]) for part in parts])


def with_a_gap(q, v, a, gap=0.12, runs=5):
    """A link that rests while the motor crosses the gap, with 0.3 of the inertia and 0.8 of the friction."""
    link = np.empty((runs, len(q) // runs))
    for number, angles in enumerate(q.reshape(runs, -1)):
        place = angles[0]
        for i, motor in enumerate(angles):
            place = link[number, i] = min(max(place, motor - gap / 2), motor + gap / 2)
    rests = (np.diff(link, axis=1, prepend=np.nan) == 0.0).ravel()
    return WEIGHT * (np.sin(link.ravel()) - np.sin(q)) - rests * (0.7 * INERTIA * a + 0.2 * DAMPING * v)


# name: data, what must be named, a parameter with its truth and the share it may be off by
HIDDEN = {
    "a spring that stiffens": (
        lambda: pressed(4, cubic),
        {"cubic_stiffness"},
        ("cubic_stiffness", "k3", 1.5e6, 0.05),
    ),
    "a relaxation and a zero": (
        lambda: session(5, lambda t, x, v, run: kelvin_voigt(x, v, relaxing(t, x, v, run)) + 0.8),
        {"stress_relaxation", "bias"},
        ("stress_relaxation", "tau", 0.4, 0.1),
    ),
    "a friction": (
        lambda: swings(1, rubbing),
        {"coulomb_friction"},
        ("coulomb_friction", "force", 0.3, 0.05),
    ),
    "a friction read coarsely": (
        lambda: read(swings(2, rubbing), step=2 * np.pi / 4096),
        {"coulomb_friction"},
        ("coulomb_friction", "force", 0.3, 0.1),
    ),
    "a spring and a friction": (
        lambda: swings(3, lambda q, v, a: rubbing(q, v, a) + 6.0 * q),
        {"joint_spring", "coulomb_friction"},
        ("coulomb_friction", "force", 0.3, 0.05),
    ),
    "a ripple behind a delay": (
        lambda: swings(4, lambda q, v, a: 0.3 * np.sin(15.0 * q), sensor=late),
        {"delay", "torque_ripple"},
        ("delay", "time", 0.048, 0.05),
    ),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_is_named_with_its_size_and_nothing_else(name):
    made, expected, (effect, parameter, truth, off) = HIDDEN[name]
    data = made()
    found = answer(data, *(() if name in ALL else SOME[data.name]))
    assert found.verdict is Verdict.MISSING
    assert named(found) == expected
    assert found.complete
    entry = next(entry for entry in found.accepted if entry.effect == effect)
    assert entry.parameters[parameter].value == pytest.approx(truth, rel=off)
    noise = NOISE_N if found.channel == "contact" else NOISE_NM
    assert found.final.rmse == pytest.approx(noise, rel=0.15)


def test_a_gap_is_found_with_what_the_motor_keeps_of_inertia_and_friction():
    found = answer(swings(5, with_a_gap), *SOME["joint_1"])
    assert named(found) == {"backlash"}
    (entry,) = found.accepted
    for name, truth in (("gap", 0.12), ("motor_inertia", 0.3), ("motor_friction", 0.8)):
        told = entry.parameters[name]
        assert abs(told.value - truth) < 3.0 * told.std_err < 0.2, name


NOTHING = {
    "white noise": lambda: pressed(3),
    "slow noise": lambda: pressed(3, correlation=0.97),
    "a depth in coarse steps": lambda: read(pressed(6), step=1e-4, acceleration=False),
    "a depth through noise": lambda: read(pressed(7), noise=3e-5, acceleration=False),
    "a joint": lambda: swings(1),
    "a coarse encoder": lambda: read(swings(2), step=2 * np.pi / 4096),
    "100 Hz": lambda: read(swings(3, rate_hz=100.0), step=2 * np.pi / 16384),
}


@pytest.mark.parametrize("name", NOTHING)
def test_where_nothing_is_hidden_nothing_is_missing(name):
    data = NOTHING[name]()
    found = answer(data, *(() if name in ALL else SOME[data.name]))
    assert (found.verdict, named(found), found.complete) == (Verdict.ADEQUATE, set(), True)
    assert found.final.rmse == pytest.approx(found.baseline.rmse)
    assert found.remaining.depends_on == found.depends_on == []


UNKNOWN = {
    "a relaxation": (lambda: pressed(6, relaxing), "stress_relaxation"),
    "waves of the depth": (lambda: pressed(6, lambda t, x, v, run: np.sin(900.0 * x) * (x > 0)), None),
    "waves of the speed": (lambda: swings(6, lambda q, v, a: 0.2 * np.sin(3.0 * v)), None),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_the_library_lacks_gets_no_name(name):
    made, lacking = UNKNOWN[name]
    data = made()
    found = answer(data, *(effect for effect in SOME[data.name] if effect != lacking))
    assert (found.verdict, named(found), found.complete) == (Verdict.UNEXPLAINED, set(), False)
    assert found.remaining.times_floor > 1.5
    assert found.depends_on
    assert found.next_experiment


IMPOSTORS = [
    pytest.param(
        lambda: swings(7, lambda q, v, a: 1.0 * q**3),
        "cubic_stiffness",
        "joint_spring",
        marks=pytest.mark.xfail(
            strict=True, reason="its weight turns negative, and it leaves 1.1 times the floor"
        ),
    ),
    (lambda: swings(8, rubbing), "coulomb_friction", "quadratic_friction"),
    (
        lambda: pressed(9, lambda t, x, v, run: 600.0 * np.maximum(x - 0.005, 0.0)),
        "layered_stiffness",
        "bias",
    ),
]


@pytest.mark.parametrize(("made", "right", "wrong"), IMPOSTORS)
def test_an_effect_is_not_called_by_another_s_name(made, right, wrong):
    data = made()
    assert named(answer(data, wrong)) == set()
    assert named(answer(data, right, wrong)) == {right}


def test_what_is_found_stays_found_beside_a_law_that_nobody_knows():
    found = answer(
        swings(6, lambda q, v, a: 3.0 * rubbing(q, v, a) + 0.05 * np.sin(8.0 * q) * q), *SOME["joint_1"]
    )
    assert "coulomb_friction" in named(found)


def test_what_became_needless_is_dropped():
    """A cubic spring is drawn by a straight one and a layer until the cubic one is tried."""
    data = pressed(4, cubic)
    assert named(answer(data, "layered_stiffness", "bias", "cubic_stiffness")) == {"cubic_stiffness"}


GROUPS = [
    # where a sine is nearly straight, a weight and a spring are one
    ("inertia", lambda: swings_small(0.1), {"weight", "joint_spring"}, True),
    ("inertia", lambda: swings_small(1.0), {"weight", "joint_spring"}, False),
]


def swings_small(scale):
    """A joint about its rest, with a weight that its model does not know."""
    made = swings(5)
    motion = {name: scale * getattr(made, name) for name in ("position", "velocity", "acceleration")}
    noise = 0.1 * NOISE_NM * np.random.default_rng(0).standard_normal(len(made))
    small = replace(made, **motion)
    torque = 0.05 * small.acceleration + 0.15 * small.velocity + WEIGHT * np.sin(small.position) + noise
    return replace(small, effort=torque)


@pytest.mark.parametrize(("base", "made", "group", "together"), GROUPS)
def test_effects_that_draw_the_same_are_named_as_a_group(base, made, group, together):
    model, tried = MODELS[base]().build(ModelContext()), [EFFECTS[name]() for name in group]
    found = diagnose(made(), model, tried, rng=np.random.default_rng(1)).channels[0]
    (entry,) = (entry for entry in found.accepted if entry.effect in group)
    assert (group <= {entry.effect, *entry.confused_with}) is together
    if together:
        assert set(found.next_experiment.separates) >= group


def held_joint(sag, step):
    """A joint that is pulled to and fro at 10 Hz, and sags and comes back as time goes on [steps of 0.25]."""
    rng, run = np.random.default_rng(3), np.repeat(np.arange(6), 47)
    t = np.arange(len(run)) * 0.1
    x = np.sin(2 * np.pi * t / 4.0)
    v, a = (np.gradient(s, 0.1) for s in (x, np.gradient(x, 0.1)))
    felt = 0.25 * (sag * np.cos(2 * np.pi * t / 28.2) + rng.normal(0.0, 0.5, len(x)))
    made = swings(1).select(np.zeros(len(run), dtype=np.int64))
    motion = {"position": x, "velocity": v, "acceleration": a}
    return replace(made, time_s=t, **motion, effort=np.round(felt / step) * step if step else felt, run=run)


@pytest.mark.parametrize(("step", "verdict"), [(0.25, Verdict.INSUFFICIENT), (0.0, Verdict.UNEXPLAINED)])
def test_what_is_below_a_step_of_the_reader_is_neither_named_nor_ruled_out(step, verdict):
    model = Model("elastic", (EFFECTS["stiffness"](), EFFECTS["bias"]()))
    known = [EFFECTS["quantisation"]()]
    found = diagnose(held_joint(0.8, step), model, known, rng=np.random.default_rng(0)).channels[0]
    assert found.verdict is verdict
    assert ("finer" in found.reason) is (step > 0.0)


def test_data_that_cannot_say_gets_a_reason_and_an_experiment():
    found = answer(pressed(3).of_runs(np.array([0])))
    assert found.verdict is Verdict.INSUFFICIENT
    assert found.complete is None
    assert found.accepted == []
    assert found.baseline is None
    assert found.next_experiment.instruction


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("the effort never changes; check the sensor and the column", "check the sensor and the column"),
        ("the deepest indentation is 9 m; is the displacement in millimetres?", "check units and columns"),
        ("only 60 samples; record at least 100", "begin and end each run free of any effort"),
    ],
)
def test_data_that_is_wrong_is_to_be_checked_before_another_experiment(reason, words):
    assert sufficient(reason, ChannelKind.CONTACT).instruction.startswith(words)


def test_the_next_experiment_says_what_the_recorded_motion_was():
    said = exploring(["past motion"], pressed(3)).instruction
    assert said.startswith(
        "hold still for longer, then repeat the motion at once (the motion recorded here goes"
    )


@pytest.mark.parametrize("digits", [None, 6])
def test_data_without_noise_is_judged_to_its_last_digits(digits):
    data = pressed(5)
    force = kelvin_voigt(data.position, data.velocity)
    exact = replace(data, effort=force if digits is None else np.round(force, digits))
    found = answer(exact, "cubic_stiffness", "layered_stiffness", "bias")
    assert found.verdict is Verdict.ADEQUATE
    assert found.final.parameters["stiffness.k"].value == pytest.approx(K, rel=1e-5)
    small = 1e2 * np.maximum(data.position, 0.0) ** 3
    other = answer(replace(exact, effort=force + small), "cubic_stiffness", "layered_stiffness", "bias")
    assert named(other) == {"cubic_stiffness"}


def warm(data, per_kelvin):
    """The same object, softer where it is warm; temperature was recorded beside."""
    start = np.random.default_rng(3).permutation(len(data.runs))
    temperature = 20.0 + 2.0 * start[data.run] + np.sin(data.time_s)
    effort = data.effort * (1.0 - per_kelvin * (temperature - 25.0))
    more = {"context": {"temperature": temperature}, "recorded": frozenset({"temperature"})}
    return replace(data, effort=effort, **more)


def test_an_error_that_depends_on_what_was_recorded_says_so():
    found = answer(warm(pressed(11), 0.01), *SOME["contact"])
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.depends_on[0] == "temperature"
    assert "different values of temperature" in found.next_experiment.instruction


def test_what_was_recorded_and_does_nothing_is_not_blamed():
    assert answer(warm(pressed(12), 0.0), *SOME["contact"]).verdict is Verdict.ADEQUATE


CHANGES = {
    "a sensor of another scale": (lambda force, run: np.where(run == 2, 1.2 * force, force), 2),
    "a dead sensor": (lambda force, run: np.where(run == 4, 0.0, force), 4),
    "another zero": (lambda force, run: force + 0.5 * (run % 2), None),
}


@pytest.mark.parametrize("change", CHANGES)
def test_runs_that_do_not_follow_one_law_are_told_and_no_effect_is_blamed(change):
    bend, odd = CHANGES[change]
    data = session(5, lambda t, x, v, run: bend(kelvin_voigt(x, v), run))
    found = answer(data, *SOME["contact"])
    assert (found.verdict, named(found)) == (Verdict.UNEXPLAINED, set())
    assert "do not follow one law" in found.reason
    assert odd is None or f"run {odd} is off" in found.reason
    assert found.depends_on == ["run"]
    assert found.noise_floor < 0.5 * found.baseline.rmse


DRAWN = 0.15 * np.random.default_rng(8).standard_normal(8)


def test_specimens_that_differ_by_a_gain_are_told_with_their_spread():
    data = session(8, lambda t, x, v, run: (1.0 + DRAWN[run]) * kelvin_voigt(x, v))
    found = answer(data, *SOME["contact"], "run_gain", "run_offset")
    assert named(found) == {"run_gain"}
    assert found.accepted[0].parameters["spread"].value == pytest.approx(float(np.std(DRAWN)), rel=0.2)


def test_hum_in_contact_is_not_called_adequate_and_its_frequency_is_told():
    found = answer(pressed(2, lambda t, x, v, run: 0.4 * np.sin(2 * np.pi * 7.3 * t)), *SOME["contact"])
    assert (found.verdict, named(found)) == (Verdict.UNEXPLAINED, set())
    assert "swings at 7.3" in found.reason
    assert found.depends_on == ["time"]


def test_the_same_seed_gives_the_same_answer_and_processes_change_nothing():
    channels = [replace(made, name=name) for name, made in (("b", swings(1, rubbing)), ("a", swings(2)))]

    effects = [EFFECTS[name]() for name in ("coulomb_friction", "joint_spring", "bias")]

    def answers(processes):
        rng = np.random.default_rng(5)
        return diagnose(channels, SWING, effects, rng=rng, file="x.csv", processes=processes)

    one, again, apart = answers(1), answers(1), answers(2)
    assert one == again == apart
    assert [entry.channel for entry in one.channels] == ["b", "a"]
    assert one.channels[0].verdict is Verdict.MISSING
    assert (one.file, one.model) == ("x.csv", "pendulum")


def test_a_result_is_read_back_from_its_own_text_and_progress_is_told():
    told = []
    rng, effects = np.random.default_rng(1), [EFFECTS["cubic_stiffness"](), EFFECTS["bias"]()]
    found = diagnose(pressed(4, cubic), PRESS, effects, rng=rng, progress=lambda *what: told.append(what))
    assert type(found).model_validate_json(found.model_dump_json()) == found
    assert {"complete", "remaining", "accepted", "ranking", "depends_on"} <= found.model_dump()["channels"][
        0
    ].keys()
    assert all(0.0 <= share <= 1.0 for _, share in told)
    assert {"contact: beside stiffness, damping: bias"} <= {what for what, _ in told}
    (entry,) = found.channels[0].accepted
    assert entry.rmse_after < 0.3 * entry.rmse_before
    assert entry.p_value <= 0.01
    assert entry.parameters["k3"].unit == "N/m^3"


@pytest.mark.parametrize(
    ("base", "tried", "not_tried"),
    [
        ("inertia", "weight", "gravity_tilt"),
        ("pendulum", "gravity_tilt", "weight"),
        ("pendulum", "coulomb_friction", "damping"),
        ("kelvin_voigt", "cubic_stiffness", "run_gain"),
    ],
)
def test_what_is_tried_fits_the_channel_and_its_model(base, tried, not_tried):
    data = pressed(1) if base == "kelvin_voigt" else swings(1)
    names = {e.name for e in candidates(data, MODELS[base]().build(ModelContext()), library())}
    assert tried in names
    assert not_tried not in names
