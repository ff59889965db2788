"""`palpate effects`: the vocabulary in words, as equations, and drawn."""

import io

import numpy as np
import pytest
from rich.console import Console

from docs.make_effects import DOCUMENT, renewed
from estimation.effects import EFFECTS
from palpate.render.effects import Example, drawing, drawn, kind_of, library, print_effect, print_library
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run

BLANK = "⠀"


def test_all_effects_are_listed_with_what_one_sees():
    told = run("effects").stdout
    listed = as_json("effects")["effects"]
    assert {one["name"] for one in listed} == set(EFFECTS)
    assert all(one["name"] in told for one in listed)
    assert listed[0].keys() >= {"equation", "signature", "confused_with", "parameters", "physics", "source"}


def test_one_effect_is_told_in_full_and_drawn():
    result = run("effects", "backlash")
    effect = EFFECTS["backlash"]()
    told = " ".join(result.stdout.split())
    for words in (effect.equation, effect.physics, effect.signature, *effect.confused_with):
        assert words in told
    assert "with backlash" in result.stdout
    assert ["probe", "--hidden", "backlash", "-o", "backlash.mcap"] in next_commands(result)


def test_a_force_of_rounding_errors_is_drawn_from_zero(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")  # which a pipe heeds too
    told = run("effects", "dry_friction").stdout
    assert "contact force [N], 0 to 4.73:" in told
    assert max(map(len, told.splitlines())) <= 60


def test_on_the_own_motion_it_is_drawn_beside_the_fitted_model(hardening):
    told = done("effects", "stress_relaxation", "--on", hardening)
    assert "contact force" in told.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cubic_stifness",), ("no effect", "cubic_stiffness")),
        (("backlash", "--on", "HARDENING"), ("backlash", "contact")),
        (("--on", "HARDENING"), ("name the effect",)),
        (("bias", "--on", "none.csv"), ("none.csv", "no such file")),
    ],
)
def test_what_cannot_be_shown_is_refused(arguments, words, hardening):
    assert_refused(run("effects", *(hardening if one == "HARDENING" else one for one in arguments)), *words)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_lists_and_drawings_fit_the_terminal_and_break_no_name(width):
    out = io.StringIO()
    console = Console(file=out, width=width, no_color=True)
    print_library(console, library())
    for name in ("backlash", "cubic_stiffness", "rigid_body"):
        effect = EFFECTS[name]()
        print_effect(console, effect, Example.plain(effect, kind_of(effect)))
    assert max(map(len, out.getvalue().splitlines())) <= width
    assert "⣿ with cubic_stiffness\n" in "".join(line.rstrip() + "\n" for line in out.getvalue().splitlines())
    assert set(EFFECTS) <= set(out.getvalue().split())


def test_every_example_that_is_drawn_shows_something():
    examples = {one.name: example for one in library() if (example := Example.plain(one, kind_of(one)))}
    for name, example in examples.items():
        share = np.abs(example.effort() - example.data.effort).max() / np.ptp(example.data.effort)
        assert share > (0.02 if name == "damping" else 0.05), name  # the damping of the plain model is small
    assert len(examples) > 35


def test_friction_that_differs_between_directions_is_drawn_so_over_velocity():
    effect = EFFECTS["asymmetric_friction"]()
    example = Example.plain(effect, kind_of(effect))
    effort, v = example.effort() - example.data.effort, example.data.velocity
    assert effort[v > 1.0].mean() > 2.0 * -effort[v < -1.0].mean() > 0.0
    assert "over velocity [rad/s]" in next(line.plain for line in drawn(example, 120) if "over" in line.plain)


def test_what_needs_an_arm_has_no_plain_example():
    effect = EFFECTS["rigid_body"]()
    assert Example.plain(effect, kind_of(effect)) is None


def test_a_curve_is_drawn_where_it_is():
    x = np.linspace(0.0, 1.0, 5)
    lines = [line.plain for line in drawing((x, x, "red"), (x, 1.0 - x, "blue"), 4, 4)]
    assert [line[number] > BLANK for number, line in enumerate(lines)] == [True] * 4
    assert [line[3 - number] for number, line in enumerate(lines)] == ["·"] * 4
    flat = [line.plain for line in drawing((x, x, "red"), (x, np.zeros(5), "blue"), 4, 2)]
    assert all(char > BLANK for char in flat[-1])


def test_the_document_has_the_same_tables():
    text = DOCUMENT.read_text(encoding="utf-8")
    assert renewed(text) == text
