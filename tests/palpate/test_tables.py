"""Tables in narrow terminals."""

import io

import pytest
from rich.console import Console

from palpate import console
from palpate.text.bars import LONGEST, Bar


def printed(what, width):
    out = io.StringIO()
    Console(file=out, width=width).print(what)
    return out.getvalue()


@pytest.mark.parametrize("width", [40, 60, 100])
def test_a_table_that_is_too_wide_is_folded_and_not_cut(width):
    table = console.table("", "what is measured", "value", "", right=("value",))
    table.add_row("viscoelasticity of a long and soft thing", "-123456.7 ± 89.1", Bar(0.5, "red"))
    shown = printed(table, width)
    assert "…" not in shown
    assert all(len(line) <= width for line in shown.splitlines())
    letters = "".join(shown.split())
    for number in ("-123456.7", "±", "89.1"):
        assert number in letters
    text = "".join("".join(line.split("   ")[0].split()) for line in shown.splitlines()[2:])
    assert "viscoelasticityofalongandsoftthing" in text


@pytest.mark.parametrize(("share", "drawn"), [(0.0, ""), (0.5, "█" * 9), (1.0, "█" * 18), (7.0, "█" * 18)])
def test_a_bar_is_as_long_as_its_share(share, drawn):
    assert printed(Bar(share, "red"), 100).strip() == drawn


def test_a_bar_makes_room_for_words():
    table = console.table("", "what", "")
    table.add_row("0123456789 " * 4, Bar(1.0, "red"))
    assert printed(table, 100).count("█") == LONGEST
    assert printed(table, 44).count("█") < LONGEST / 4
