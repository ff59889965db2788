"""Error budget in every view: sentence, bars, picture, and indistinguishable kinds."""

import io
import re
from xml.etree import ElementTree

import pytest
from rich.console import Console

from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.diagnosis.result import RemainingError
from palpate.estimation.kinds import Kind
from palpate.render import palette, terminal
from palpate.render.diagnosis import budget_svg, budget_view, diagnosis_verdict
from palpate.render.recording.revisions import budget_markdown


def share(kind, value, form="unknown", effects=(), low=None, high=None, **more):
    shares = {"share": value, "interval": (value - 0.1, value + 0.1)}
    shares |= {"necessary": value / 2 if low is None else low, "sufficient": value if high is None else high}
    told = {"replaceable_by": [], "experiment": "", **more}
    return {"kind": kind, "form": form, "effects": list(effects), **shares, **told}


RELAXATION = share("time_memory", 0.61, "approximate", ["relaxation_spectrum"], 0.4, 0.8)
SHAPE = share("elastic_shape", 0.25, effects=["power_law_stiffness"])
RUNS = share("run_differences", 0.1, "exact", ["run_gain"])
STEP = {"parameters": {}, "p_value": 0.005, "physics": "p", "equation": "e", "signature": "s"}


def diagnosis(*budget, verdict="missing", noise=0.04, unexplained=0.0, free_air=0.03, accepted=(), **more):
    entries = [
        {**STEP, "effect": name, "form": form, "rmse_before": 0.144, "rmse_after": 0.05, "confused_with": []}
        for name, form in accepted
    ]
    return ChannelDiagnosis(
        channel="contact",
        verdict=verdict,
        reason="r",
        effort_unit="N",
        noise_floor=0.03,
        floor={"value": 0.03, "at_most": free_air is None, "free_air": free_air, "share_left": 0.0},
        budget=list(budget),
        rest={"noise": noise, "unexplained": unexplained},
        baseline={"rmse": 0.144, "parameters": {}},
        final={"rmse": 0.05, "parameters": {}},
        accepted=entries,
        **more,
    )


def printed(found, width):
    console = Console(file=io.StringIO(), width=width)
    terminal._print_budget(console, "contact", budget_view(found))
    return console.file.getvalue()


def test_terminal_explains_only_the_forms_that_occur():
    told = printed(diagnosis(RELAXATION, SHAPE), 120)
    assert "Approximate: " in told
    assert "Exact: " in printed(diagnosis(RUNS, SHAPE), 120)
    assert "Exact: " not in told


def test_budget_sentence_states_all_shares_or_noise():
    told = budget_view(diagnosis(RELAXATION, SHAPE, RUNS)).sentence
    assert told == (
        "Of the 0.144 N error: relaxation 61 %, elastic shape 25 %, differences between runs 10 %, noise 4 %."
    )
    view = budget_view(diagnosis(verdict="adequate", noise=1.0))
    assert view.sentence == "The whole error of 0.144 N is within the noise."
    bounded = budget_view(diagnosis(verdict="adequate", noise=1.0, free_air=None))
    assert bounded.sentence == "The whole error of 0.144 N may be noise."
    rare = budget_view(diagnosis(verdict="unexplained", noise=1.0))
    assert rare.sentence == "No kind of effect accounts for the error of 0.144 N."
    left = RemainingError(rmse=0.144, times_floor=5.8, depends_on=[])
    far = diagnosis(verdict="adequate", noise=1.0).model_copy(update={"remaining": left})
    assert budget_view(far).sentence == "The whole error of 0.144 N depends on no recorded signal."
    found = ChannelDiagnosis(channel="a", verdict="insufficient", reason="r", effort_unit="N")
    assert budget_view(found) is None


def test_unmeasured_noise_is_an_upper_bound():
    """Then what nothing explains is a lower bound: the two add up."""
    told = budget_view(diagnosis(RELAXATION, noise=0.3, unexplained=0.09, free_air=None)).sentence
    assert told.endswith("relaxation 61 %, noise at most 30 %, unexplained at least 9 %.")
    little = budget_view(diagnosis(RELAXATION, noise=0.002, free_air=None)).sentence
    assert little.endswith("noise at most 1 %.")
    measured = budget_view(diagnosis(RELAXATION, noise=0.3, unexplained=0.09)).sentence
    assert measured.endswith("relaxation 61 %, noise 30 %, unexplained 9 %.")


def test_every_kind_has_its_own_word_and_color():
    assert len({kind.word for kind in Kind}) == len(Kind)
    assert set(palette.KINDS) == set(Kind)
    assert len(set(palette.KINDS.values())) == len(Kind)


@pytest.mark.parametrize("width", [80, 100, 110, 120])
def test_terminal_shows_a_row_for_each_kind_and_breaks_no_effect_name(width):
    names = ["position_dependent_friction", "load_dependent_presliding"]
    found = diagnosis(share("run_differences", 0.61, "approximate", names), RUNS, free_air=None)
    told = printed(found, width)
    assert all(name in told for name in names)
    assert max(map(len, told.splitlines())) <= width
    told = printed(diagnosis(RELAXATION, SHAPE, RUNS, free_air=None), width)
    assert told.startswith("contact  Of the 0.144 N error: relaxation 61 %")
    assert max(map(len, told.splitlines())) <= width
    (row,) = [line for line in told.splitlines() if line.strip().startswith("relaxation ")]
    for words in ("61 %", "40 to 80 %", "approximate"):
        assert words in row
    assert "≤ 4 %" in told  # of noise that nothing measured
    assert "closest: power_law_stiffness" in re.sub(r"\s+", " ", told)
    assert "closest: run_gain" not in told


def test_range_goes_from_the_smaller_to_the_larger_share_in_every_view():
    """A kind may explain less alone than is lost without it."""
    view = budget_view(diagnosis(share("friction", 0.6, low=0.63, high=0.53), SHAPE))
    assert view.parts[0].range_text == "53 to 63 %"
    table = printed(diagnosis(share("friction", 0.6, low=0.63, high=0.53), SHAPE), 120)
    header = " ".join(re.sub(r"\s+", " ", table).split())
    assert "alone share or added last form" in header
    assert "53 to 63 %" in header
    picture = budget_svg(view, 800)
    assert ">alone or added last<" in picture
    assert "53 to 63 %" in picture


def test_indistinguishable_kinds_come_with_a_separating_experiment():
    unsure = {"replaceable_by": ["drift"], "experiment": "record the unloaded sensor"}
    other = {"replaceable_by": ["time_memory"], "experiment": "record the unloaded sensor"}
    found = diagnosis(share("time_memory", 0.6, **unsure), share("drift", 0.2, **other))
    (told,) = budget_view(found).confusions
    assert told == (
        "These data cannot tell relaxation from drift. "
        "To separate relaxation from drift: record the unloaded sensor."
    )
    assert told in re.sub(r"\s+", " ", printed(found, 80))


def test_picture_stacks_the_shares_to_its_whole_width():
    picture = ElementTree.fromstring(budget_svg(budget_view(diagnosis(RELAXATION, SHAPE, RUNS)), 800))
    space = "{http://www.w3.org/2000/svg}"
    stacked = [rect for rect in picture.iter(f"{space}rect") if rect.get("y") == "0"]
    assert [rect.get("fill") for rect in stacked] == [
        palette.KINDS[Kind.TIME_MEMORY],
        palette.KINDS[Kind.ELASTIC_SHAPE],
        palette.KINDS[Kind.RUN_DIFFERENCES],
        palette.NOISE,
    ]
    assert [float(rect.get("width")) for rect in stacked] == pytest.approx([488, 200, 80, 32])
    assert float(stacked[1].get("x")) == pytest.approx(488)


@pytest.mark.parametrize("width", [340, 940])
def test_names_of_effects_never_become_markup_of_the_picture(width):
    strange = "<script>alert(1)</script>"
    text = budget_svg(budget_view(diagnosis(share("friction", 0.9, effects=[strange]))), width)
    assert "<script" not in text
    ElementTree.fromstring(text)


def test_approximate_form_and_unnamed_kinds_are_marked_beside_names():
    names = [("relaxation_spectrum", "approximate"), ("run_gain", "exact")]
    told = diagnosis_verdict(diagnosis(RELAXATION, RUNS, accepted=names)).sentence
    assert "relaxation_spectrum (approximate) and run_gain are missing from the base model" in told
    rest = {"rmse": 0.05, "times_floor": 1.7, "depends_on": []}
    names = [("relaxation_spectrum", "approximate")]
    told = diagnosis_verdict(
        diagnosis(RELAXATION, SHAPE, accepted=names, complete=False, remaining=rest)
    ).sentence
    assert told.endswith("The form of elastic shape (25 %) is not known.")


def test_unexplained_verdict_names_only_kinds():
    found = diagnosis(SHAPE, share("friction", 0.2, effects=["dry_friction"]), verdict="unexplained")
    told = diagnosis_verdict(found).sentence
    assert "effect is known, but not its form: elastic shape (25 %) and friction (20 %)." in told
    assert "dry_friction" not in told


def test_recording_describes_the_budget_as_a_table():
    view = budget_view(diagnosis(RELAXATION, SHAPE))
    text = budget_markdown(view)
    assert view.sentence in text
    assert "| relaxation | 61 % | 51 to 71 % | 40 to 80 % | approximate | relaxation_spectrum |" in text


def test_names_of_fonts_are_valid_in_css():
    """A browser ignores the whole list if a word of an unquoted name begins with a digit."""
    for name in palette.FONT.split(","):
        assert re.fullmatch(r"'[^']+'|[A-Za-z-][\w-]*(?: [A-Za-z-][\w-]*)*", name.strip())
