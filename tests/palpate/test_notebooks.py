"""Notebooks: they run, show their results, and find hidden effects."""

import ast
import json
import re
import sys
from queue import SimpleQueue
from threading import current_thread
from types import ModuleType
from urllib.request import urlopen

import plotly.io
import pytest

from palpate.render.notebook import PageAddress, notebook_progress
from palpate.robot_io.errors import InputError
from palpate.study import Study
from palpate.workbench import server
from tests.palpate.cli import ROOT
from tests.palpate.presses import write_presses

NOTEBOOKS = ROOT / "docs" / "notebooks"


def run_notebook(name, folder, monkeypatch):
    """Run all cells as IPython does; gives their names, and what the last line of each cell is."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(plotly.io.renderers, "default", "json")  # the notebooks set another one
    names, shown = {}, []
    for cell in json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert not cell["outputs"], "stored outputs grow old: clear them"
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), name, "exec"), names)
        if last is not None:
            shown.append(eval(compile(ast.Expression(last.value), name, "eval"), names))
    return names, shown


def as_html(results):
    shown = [result for result in results if hasattr(result, "_repr_html_") and not has_figure([result])]
    return "".join(result._repr_html_() for result in shown)


def has_figure(results):
    return any("plotly" in type(result).__module__ for result in results)


@pytest.mark.slow
def test_own_file_notebook_runs(tmp_path, monkeypatch):
    names, shown = run_notebook("your-own-file.ipynb", tmp_path, monkeypatch)
    (entry,) = names["diagnosis"].channels[0].accepted
    assert entry.effect == "stress_relaxation"
    lower, upper = names["relaxation"]["stress_relaxation.tau"].interval
    assert lower < 0.4 < upper
    assert [name for name, value in names["relaxation"].items() if value.determined == "no"] == ["damping.c"]
    html = as_html(shown)
    assert html.count("<table>") == 3
    assert '<a href="http://127.0.0.1:' in html
    assert has_figure(shown)
    (address,) = (result for result in shown if isinstance(result, PageAddress))
    with urlopen(address, timeout=60) as page:
        assert b"palpate workbench" in page.read()
    assert (tmp_path / "press.html").stat().st_size > 10_000


@pytest.mark.slow
def test_data_set_is_exported_to_a_simulator(tmp_path, monkeypatch):
    names, shown = run_notebook("lerobot-to-mujoco.ipynb", tmp_path, monkeypatch)
    assert names["after"] < 1.05 * names["torque_error"](names["real"])
    assert names["after"] < 0.1 * names["before"]
    assert "coulomb_friction" in as_html(shown)
    assert has_figure(shown)


@pytest.mark.slow
def test_tissue_notebook_runs(tmp_path, monkeypatch):
    names, shown = run_notebook("tissue.ipynb", tmp_path, monkeypatch)
    effects = {entry.effect for entry in names["diagnosis"].channels[0].accepted}
    assert effects == {"stress_relaxation", "exponential_stiffness"}
    truths = {"stiffness.k": 300.0, "exponential_stiffness.b": 400.0, "stress_relaxation.tau": 0.6}
    for name, truth in truths.items():
        lower, upper = names["found"][name].interval
        assert lower < truth < upper, name
    assert as_html(shown).count("<table>") == 3


def test_notebook_shows_and_removes_a_progress_bar(few_effects, monkeypatch, tmp_path):
    said = []

    class Handle:
        def update(self, html):
            said.append(html)

    display = ModuleType("IPython.display")
    display.HTML, display.display = str, lambda html, display_id: Handle()
    notebook_progress()("fitting", 0.5)
    assert not said
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    Study(write_presses(tmp_path / "press.csv"), keep=False).diagnose(plan=False)
    assert "<progress value=" in said[0]
    assert said[-1] == ""
    notebook_progress()("a < b", 0.25)
    assert said[-1] == '<progress value="0.25"></progress> a &lt; b'


def test_address_is_a_link_in_a_notebook():
    assert PageAddress('http://a/"')._repr_html_() == (
        '<a href="http://a/&quot;" target="_blank">http://a/&quot;</a>'
    )


def test_one_page_is_opened_by_threads_that_do_not_hold_the_program(monkeypatch, tmp_path):
    """Opening a browser may take until the browser is closed."""
    seen = SimpleQueue()
    monkeypatch.setattr(server, "_pages", [])
    monkeypatch.setattr(
        server, "serve", lambda home, listening: seen.put((listening, current_thread().daemon))
    )
    monkeypatch.setattr(server.webbrowser, "open", lambda url: seen.put((url, current_thread().daemon)))
    study = Study(write_presses(tmp_path / "press.csv"), keep=False)
    address = study.workbench(browser=False)
    listening, is_daemon = seen.get(timeout=60.0)
    assert (f"http://{':'.join(map(str, listening.getsockname()))}", is_daemon) == (address, True)
    listening.close()
    with pytest.raises(InputError, match=f"already open at {re.escape(address)}"):
        study.workbench()
    server._pages.clear()
    other = study.workbench()
    opened = dict(seen.get(timeout=60.0) for _ in range(2))
    assert opened.pop(other) is True
    (listening,) = opened
    listening.close()
