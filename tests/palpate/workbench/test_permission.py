"""The page's question before a real arm gets power: only who sees the terminal can say yes."""

import asyncio
import re

import pytest
from nicegui import Client, core, ui
from nicegui.page import page

from palpate.workbench.layout import _permitted


def answered(capsys, typed, *, yes=True):
    """Whether the question is answered by yes where this is typed, and the number of the terminal."""

    async def ask(client):
        with client:
            return await _permitted(8.0, ["palpate", "probe", "--robot", "my arm.yaml"])

    async def answer():
        core.loop = asyncio.get_running_loop()
        client = Client(page(""))
        asked = asyncio.create_task(ask(client))
        await asyncio.sleep(0)
        code = re.search(r"type (\d{6}) there", capsys.readouterr().err)[1]
        elements = list(client.elements.values())
        said = str([one._to_dict() for one in elements])
        assert "press with 8 N" in said
        assert "palpate probe --robot 'my arm.yaml'" in said
        assert code not in said
        next(one for one in elements if isinstance(one, ui.input)).value = typed(code)
        next(one for one in elements if isinstance(one, ui.dialog)).submit(yes)
        return await asked, code

    return asyncio.run(answer())


def test_the_number_that_the_terminal_shows_permits_it_and_is_another_each_time(capsys):
    given = [answered(capsys, lambda code: f" {code}\n") for _ in range(5)]
    assert all(permitted for permitted, _ in given)
    assert len({code for _, code in given}) > 1


@pytest.mark.parametrize(
    "typed",
    [lambda code: "", lambda code: None, lambda code: "yes", lambda code: f"{(int(code) + 1) % 10**6:06d}"],
)
def test_anything_else_does_not(capsys, typed):
    assert not answered(capsys, typed)[0]


def test_neither_does_a_no_with_the_number(capsys):
    assert not answered(capsys, lambda code: code, yes=False)[0]
