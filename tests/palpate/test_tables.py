"""Tables in narrow terminals, and harmless text in CSV files."""

import io
import re
import sys
from dataclasses import replace
from functools import cache

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from rich.console import Console

from palpate.common import console
from palpate.common.console import count, safe
from palpate.common.table_files import write_table
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.study.paired_comparison import ParameterDifference
from palpate.render.build import view_of
from palpate.render.estimates import _estimate_table
from palpate.render.paired import _difference_table
from palpate.render.terminal import (
    _error_steps_table,
    _parameter_table,
    _print_budget,
    print_comparison,
    print_diagnosis,
    print_revisions,
)
from palpate.render.view import BudgetPart, BudgetView
from palpate.study import Study
from tests.few_effects import try_few_effects
from tests.revisions import revision


def printed(what, width):
    out = io.StringIO()
    Console(file=out, width=width).print(what)
    return out.getvalue()


def listed(kept, width):
    out = io.StringIO()
    print_revisions(Console(file=out, width=width), kept)
    return out.getvalue()


@pytest.mark.parametrize("width", [40, 60, 100])
def test_wide_table_is_folded_and_not_cut(width):
    table = console.table("", "what is measured", "value", right=("value",))
    table.add_row("viscoelasticity of a long and soft thing", "-123456.7 ± 89.1")
    shown = printed(table, width)
    assert "…" not in shown
    assert all(len(line) <= width for line in shown.splitlines())
    letters = "".join(shown.split())
    for number in ("-123456.7", "±", "89.1"):
        assert number in letters
    text = "".join("".join(line.split("   ")[0].split()) for line in shown.splitlines()[2:])
    assert "viscoelasticityofalongandsoftthing" in text


@pytest.mark.parametrize("width", [60, 80, 120])
def test_table_of_revisions_breaks_no_word_in_a_narrow_terminal(width):
    effects = ["force_deadband", "load_dependent_friction"]
    told = {"channel": "joint_1", "model": "rigid_body", "effort_unit": "N m", "noise_floor": 0.05}
    told |= {"created_utc": "2026-01-02T03:04:05", "parameters": {}}
    kept = [
        revision(n, 0.06928, parent=parent, effects=effects[:n], added=["", *effects][n], **told)
        for n, parent in enumerate((None, 0, 1))
    ]
    words = listed(kept, width).split()
    assert {"joint_1", "rigid_body", "force_deadband", "load_dependent_friction", "0.06928", "1.39"} <= set(
        words
    )
    assert ("2026-01-02" in words) == (width >= 100)


def test_table_of_revisions_marks_a_bound_of_the_noise_that_a_better_model_lowers():
    kept = [
        revision(0, 2.0, noise_at_most=True),
        revision(1, 0.4, noise_at_most=True, parent=0, effects=["cubic_stiffness"], added="cubic_stiffness"),
    ]
    text = listed(kept, 120)
    assert "≥ 5.00" in text
    assert "≥ 1.00" in text


@cache
def estimates_of(path, model):
    """What all estimators find in a file, once for all widths."""
    (estimates,) = Study(path, model, keep=False).estimate("all")
    return estimates


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("model", ["kelvin_voigt", "hunt_crossley"])
def test_table_of_estimates_breaks_no_word(hardening, model, width):
    shown = printed(_estimate_table(estimates_of(hardening, model), {}, width), width)
    assert {"preemptive_ransac", "robust", "±"} <= set(shown.split())
    assert all(len(line) <= width for line in shown.splitlines())


LONG = max(EFFECTS, key=len)


def differing(name, unit, *values):
    sides = [ParameterEstimate(name, unit, value, 2.3e-5, (0.0, 0.0)) for value in values]
    return ParameterDifference(name, unit, *sides)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_tables_of_parameters_break_no_word_and_no_effect_name(width):
    name, unit = f"{LONG}.transition", "N m s^2/rad^2"
    one = ParameterEstimate(name, unit, 0.0123, 5e-4, (0.0113, 0.0133))
    long, short = differing(name, unit, 1.0, 2.0), "contact_offset.offset"
    for made in (_parameter_table([one], width), _difference_table([long], width)):
        lines = printed(made, width).splitlines()
        assert any(LONG in line for line in lines)
        assert any("transition" in line for line in lines)
        assert max(map(len, lines)) <= width
    shown = printed(_difference_table([differing(short, "m", -0.000329, -0.000364)], width), width)
    assert {short, "-0.000329", "-0.000364", "-0.000035", "±", "m"} <= set(shown.split())
    assert all(len(line.rstrip()) <= width for line in shown.splitlines())


@pytest.fixture(scope="module")
def added(hardening):
    """The view of a channel after an effect was added."""
    study = Study(hardening, keep=False)
    (channel,) = view_of(study, [study.add("cubic_stiffness").result]).channels
    return channel


@pytest.fixture(scope="module")
def compared_and_diagnosed(hardening):
    """Views of a study before and after its diagnosis."""
    with pytest.MonkeyPatch.context() as patch:
        try_few_effects(patch)
        study = Study(hardening, keep=False)
        compared = view_of(study)
        study.diagnose()
        return compared, view_of(study)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_table_of_stages_breaks_no_effect_name(added, width):
    assert any(stage.number is not None for stage in added.stages)
    shown = printed(
        _error_steps_table(replace(added, error_steps=(added.error_steps[0], (f"+ {LONG}", 0.1))), width),
        width,
    )
    assert any(f"+ {LONG}" in line for line in shown.splitlines())


@pytest.mark.parametrize("width", [60, 80, 120])
def test_table_of_the_budget_breaks_no_effect_name(width):
    part = BudgetPart("gravity and load", 0.004, "#000000", "", None, 0.0, 1.0, "unknown", (LONG, "lag"))
    out = io.StringIO()
    _print_budget(Console(file=out, width=width), "joint_1", BudgetView("", (part, part)))
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for words in (LONG, " lag", "0 to 100 %", "under 1 %", "gravity and load"):
        assert sum(words in line for line in lines) == 2


@pytest.mark.parametrize("width", [60, 80, 120])
def test_comparison_and_diagnosis_fit_the_terminal(compared_and_diagnosed, width):
    out = io.StringIO()
    terminal = Console(file=out, width=width)
    compared, diagnosed = compared_and_diagnosed
    print_comparison(terminal, compared.channels)
    print_diagnosis(terminal, diagnosed)
    assert all(len(line.rstrip()) <= width for line in out.getvalue().splitlines())
    assert {"cubic_stiffness", "depth", "rmse", "parameter"} <= set(out.getvalue().split())
    (channel,) = compared.channels
    labels = [part.label for parts in channel.parts.values() for part in parts]
    assert all(label in out.getvalue() for label in labels)  # on one line each


def test_next_step_descriptions_wrap_below_the_command(monkeypatch, capsys):
    for wide, lines in ((True, 3), (False, 4)):
        made = Console(width=120 if wide else 40, force_terminal=True, no_color=True, file=sys.stdout)
        monkeypatch.setattr(console, "_console", lambda made=made, **_: made)
        console.next_steps(("palpate compare file.mcap", "where the model fails first"))
        assert len(capsys.readouterr().out.splitlines()) == lines


def test_line_below_another_is_indented_where_it_wraps(monkeypatch, capsys):
    made = Console(width=40, file=sys.stdout)
    monkeypatch.setattr(console, "_console", lambda **_: made)
    console.say_below("[yellow]one of the parameters[/yellow] is different in each group")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert all(re.match(r"  \w", line) for line in lines)


@pytest.mark.parametrize("width", [60, 120])
@pytest.mark.parametrize("text", ["[/bold]", "a[red]b", "\x1b[2Jx", "\x9b2J\\"])
def test_edited_revision_is_shown_without_markup(text, width):
    names = ("added", "channel", "model", "effort_unit", "created_utc", "software_version")
    shown = listed([revision(effects=[text], **dict.fromkeys(names, text))], width)
    assert shown.replace("\n", "").isprintable()
    assert shown.count(safe(text).replace("\\[", "[").replace("\\\\", "\\")) == (5 if width > 100 else 4)


@pytest.mark.parametrize(
    ("number", "words"), [(0, "0 rows"), (1, "1 row"), (999, "999 rows"), (18550, "18,550 rows")]
)
def test_count_has_its_noun_and_thousands_separators(number, words):
    assert count(number, "row") == words


CASES = {
    '=HYPERLINK("http://e","x")': '\'=HYPERLINK("http://e","x")',
    "-1+cmd|' /C calc'!A0": "'-1+cmd|' /C calc'!A0",
    "@SUM(A1)": "'@SUM(A1)",
    "\t=1+1": "' =1+1",
    "\x1b[2J\x9b31m": " [2J 31m",
    "-1.5e3": "-1.5e3",
    "+7": "+7",
    "-": "-",
    "Prüfling = 3": "Prüfling = 3",
}


def test_text_is_no_formula_and_no_command(tmp_path):
    table = pa.table({"measurement": [*CASES, None], "channel": list(range(len(CASES) + 1))})
    for ending in ("parquet", "csv"):
        write_table(table, tmp_path / f"table.{ending}")
    assert pa.parquet.read_table(tmp_path / "table.parquet")["measurement"].to_pylist() == [*CASES, None]
    as_text = pa.csv.ConvertOptions(column_types={"measurement": pa.string()}, strings_can_be_null=True)
    cells = pa.csv.read_csv(tmp_path / "table.csv", convert_options=as_text)["measurement"].to_pylist()
    assert [cell or None for cell in cells] == [*CASES.values(), None]


def test_names_of_columns_and_dictionaries_of_text_are_harmless_too(tmp_path):
    table = pa.table(
        {"=1+1": pa.array(["=2+2", "a"]).dictionary_encode(), "b": pa.array(["@S", "c"], pa.large_string())}
    )
    write_table(table, tmp_path / "table.csv")
    lines = (tmp_path / "table.csv").read_text(encoding="utf-8").replace('"', "").splitlines()
    assert lines == ["'=1+1,b", "'=2+2,'@S", "a,c"]
