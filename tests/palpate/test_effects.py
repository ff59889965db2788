"""`palpate effects`: effects in words, as equations, and plotted."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from docs.make_effects import DOCUMENT, renewed
from palpate.common import user_effects
from palpate.common.user_effects import guarded, try_effect
from palpate.estimation.channel import ChannelKind
from palpate.estimation.effect import AdditiveEffect, Parameter
from palpate.estimation.effects import EFFECTS
from palpate.render.effects import (
    EffectExample,
    _draw_characters,
    _draw_example,
    kind_of,
    library,
    print_effect,
    print_library,
)
from palpate.robot_io.errors import InputError
from palpate.study import Study
from tests.estimation.presses import kelvin_voigt, session
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import write_presses

BLANK = "⠀"


def test_effects_are_listed_and_one_is_described_and_plotted():
    told = run("effects").stdout
    listed = as_json("effects")["effects"]
    assert {one["name"] for one in listed} == set(EFFECTS)
    assert all(one["name"] in told for one in listed)
    assert listed[0].keys() >= {"equation", "signature", "confused_with", "parameters", "physics", "source"}
    result = run("effects", "backlash")
    effect = EFFECTS["backlash"]()
    told = " ".join(result.stdout.split())
    for words in (effect.equation, effect.physics, effect.signature, *effect.confused_with):
        assert words in told
    assert "with backlash" in result.stdout
    assert ["probe", "--hidden", "backlash", "-o", "backlash.mcap"] in next_commands(result)


def test_force_of_rounding_errors_is_drawn_from_zero(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")  # which a pipe heeds too
    told = run("effects", "dry_friction").stdout
    assert "contact force [N], 0 to 4.73:" in told
    assert max(map(len, told.splitlines())) <= 60


def test_effect_is_drawn_on_the_recorded_motion(hardening):
    assert "contact force" in done("effects", "stress_relaxation", "--on", hardening).stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cubic_stifness",), ("no effect", "cubic_stiffness")),
        (("layered",), ("no effect is called 'layered'; did you mean 'layered_stiffness'?",)),
        (("backlash", "--on", "HARDENING"), ("backlash", "contact")),
        (("--on", "HARDENING"), ("name an effect",)),
        (("bias", "--on", "none.csv"), ("none.csv", "no such file")),
    ],
)
def test_invalid_display_option_is_refused(arguments, words, hardening):
    assert_refused(run("effects", *(hardening if one == "HARDENING" else one for one in arguments)), *words)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_lists_and_plots_fit_the_terminal_and_break_no_name(width):
    out = io.StringIO()
    console = Console(file=out, width=width, no_color=True)
    print_library(console, library())
    for name in ("backlash", "cubic_stiffness", "rigid_body"):
        effect = EFFECTS[name]()
        print_effect(console, effect, EffectExample.on_simple_motion(effect, kind_of(effect)))
    assert max(map(len, out.getvalue().splitlines())) <= width
    assert "⣿ with cubic_stiffness\n" in "".join(line.rstrip() + "\n" for line in out.getvalue().splitlines())
    assert set(EFFECTS) <= set(out.getvalue().split())


def test_every_plain_example_is_drawn_and_visible():
    examples = {
        one.name: example
        for one in library()
        if (example := EffectExample.on_simple_motion(one, kind_of(one)))
    }
    for name, example in examples.items():
        share = np.abs(example.effort() - example.data.effort).max() / np.ptp(example.data.effort)
        assert share > (0.02 if name == "damping" else 0.05), name  # the damping of the plain model is small
    assert len(examples) > 35
    effect = EFFECTS["asymmetric_friction"]()
    example = EffectExample.on_simple_motion(effect, kind_of(effect))
    effort, v = example.effort() - example.data.effort, example.data.velocity
    assert effort[v > 1.0].mean() > 2.0 * -effort[v < -1.0].mean() > 0.0
    assert "over velocity [rad/s]" in next(
        line.plain for line in _draw_example(example, 120) if "over" in line.plain
    )
    effect = EFFECTS["rigid_body"]()
    assert EffectExample.on_simple_motion(effect, kind_of(effect)) is None


def test_curve_is_drawn_at_its_coordinates():
    x = np.linspace(0.0, 1.0, 5)
    lines = [line.plain for line in _draw_characters((x, x, "red"), (x, 1.0 - x, "blue"), 4, 4)]
    assert [line[number] > BLANK for number, line in enumerate(lines)] == [True] * 4
    assert [line[3 - number] for number, line in enumerate(lines)] == ["·"] * 4
    flat = [line.plain for line in _draw_characters((x, x, "red"), (x, np.zeros(5), "blue"), 4, 2)]
    assert all(char > BLANK for char in flat[-1])


def test_document_has_the_same_tables():
    text = DOCUMENT.read_text(encoding="utf-8")
    assert renewed(text) == text


DATA = session(1, lambda t, x, v, run: kelvin_voigt(x, v))


@pytest.mark.parametrize("name", EFFECTS)
def test_own_effects_pass_their_checks(name):
    for kind in ChannelKind:
        try_effect(guarded(EFFECTS[name]()), replace(DATA, kind=kind))


def test_effect_that_never_returns_is_abandoned(tmp_path, monkeypatch):
    monkeypatch.setattr(user_effects, "LIMIT_S", 0.2)
    file = tmp_path / "waits.py"
    file.write_text(
        "import time\nfrom palpate.estimation.effects.sensor_statics import Bias\n"
        "class Waits(Bias):\n    name = 'waits'\n    def __init__(self):\n        time.sleep(9)\n"
    )
    with pytest.raises(InputError, match=r"Waits.*: cannot be created: did not end within 0\.2 s"):
        Study([DATA], effects=[f"{file}:Waits"])


GUARDED_DATA = session(1)


class Power(AdditiveEffect):
    """Sound up to a depth, and then as `goes_wrong` has it."""

    name = "power"
    physics = equation = source = signature = "none"
    channels = frozenset(ChannelKind)
    gains = (Parameter("k", "N", -1e6, 1e6, (0.1, 10.0)),)
    inner = (Parameter("d", "m", 0.0, 0.2, (0.001, 0.02)),)
    goes_wrong = staticmethod(lambda data, columns: columns)

    def columns(self, data, inner):
        made = np.maximum(data.position - inner["d"], 0.0)[:, None] ** 2
        return type(self).goes_wrong(data, made) if inner["d"] > 0.015 else made


def write(data, columns):
    data.effort[:] = 0.0
    return columns


def stop(data, columns):
    raise ZeroDivisionError("by nothing")


WRONG = {
    "read-only": write,
    "by nothing": stop,
    "not finite": lambda data, columns: columns * np.nan,
}


@pytest.mark.parametrize("words", WRONG)
def test_failing_effect_is_reported_in_one_line(words):
    found = type("Wrong", (Power,), {"goes_wrong": staticmethod(WRONG[words])})
    effect, before = guarded(found()), GUARDED_DATA.effort.copy()
    try_effect(effect, GUARDED_DATA)
    with pytest.raises(InputError, match=f"effect 'power' on channel 'contact'.*{words}"):
        effect.columns(GUARDED_DATA, {"d": 0.018})
    assert np.array_equal(GUARDED_DATA.effort, before)


OWN = """\
import numpy as np

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effect import AdditiveEffect, Parameter


class Mine(AdditiveEffect):
    name = "mine"
    physics = equation = source = signature = "none"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k", "N", -1e6, 1e6, (0.1, 10.0)),)

    def columns(self, data, inner):
        depth = np.maximum(data.position, 0.0)
        return depth[:, None]
"""


@pytest.mark.parametrize(
    ("sound", "wrong", "line", "words"),
    [
        ("return depth[:, None]", "return np.linalg.inv(depth[:, None])", 16, "square"),  # raised in numpy
        ("return depth[:, None]", "return depth", 14, "shape"),
        ("return depth[:, None]", "return 0.0 * depth[:, None]", 14, "zero throughout"),
        ("return depth[:, None]", "return 1e200 + depth[:, None]", 14, r"values beyond 1e\+30"),
        ("return depth[:, None]", "return np.random.rand(len(depth), 1)", 14, "different values"),
        ('name = "mine"', 'name = "My name"', 8, "its name is"),
        ("(0.1, 10.0)", "(10.0, 0.1)", 12, "parameter 'k', .10.0, 0.1., is not in ascending order"),
        ("-1e6, 1e6", "1e6, -1e6", 12, "parameter 'k', 1e.06 and -1e.06, are not in ascending order"),
        ("(0.1, 10.0)", "(0.1, 2e6)", 12, "exceeds its bounds -1e.06 and 1e.06"),
        ('"k", "N"', '"k", "{force}/m"', 12, "valid placeholders are {effort}"),
        ('("position",)', '("pos",)', 10, "its signals contain pos. Valid: offset, time, position"),
        ("frozenset({ChannelKind.CONTACT})", '{"contact"}', 11, "ChannelKind.REVOLUTE"),
        (
            '    signals = ("position",)\n',
            '    signals = ("position",)\n    needs = 3\n',
            11,
            "its needs are",
        ),
        ('"mine"\n    physics = ', '"mine"\n    ', 7, "does not state physics"),
        ("data.position", "data.depth", 15, "depth"),
    ],
)
def test_error_of_a_user_effect_names_its_line(tmp_path, sound, wrong, line, words):
    assert sound in OWN
    (tmp_path / "mine.py").write_text(OWN.replace(sound, wrong))
    with pytest.raises(InputError, match=words) as error:
        Study(write_presses(tmp_path / "press.csv"), keep=False, effects=[f"{tmp_path}/mine.py:Mine"])
    assert f"(mine.py, line {line})" in str(error.value)


def test_valid_effect_is_unchanged_by_the_checks_and_keeps_its_module():
    effect = guarded(Power())
    assert np.array_equal(
        effect.columns(GUARDED_DATA, {"d": 0.018}), Power().columns(GUARDED_DATA, {"d": 0.018})
    )
    assert type(effect).__module__ == Power.__module__
    assert isinstance(effect, Power)
