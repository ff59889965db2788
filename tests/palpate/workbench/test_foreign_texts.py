"""Texts of foreign files are shown on the page and never become code or markup."""

import ast
import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path

import pytest
from nicegui import Client, core
from nicegui.page import page

import palpate
from palpate.estimation.study.saved_diagnosis import RESULT, with_checksum
from palpate.robot_io.session import Session, write_session
from palpate.study import Study
from palpate.workbench.layout import lay_out_page
from palpate.workbench.startup import AppState
from palpate.workbench.state import WorkbenchState
from tests.few_effects import try_few_effects
from tests.palpate.presses import write_presses

MARK = "Pwned"
HOSTILE = (
    f"{MARK}"
    + """ " :title="globalThis.Pwned=1" onclick="Pwned=1" '/><img src=x onerror=globalThis.Pwned=1>"""
    """</script><script>globalThis.Pwned=1</script>{{globalThis.Pwned=1}}${globalThis.Pwned=1}`"""
)
# By which a diagnosis is found, and what has a fixed set of words.
FIXED = {"verdict", "channel", "model", "data_sha256", "kind", "form", "replaceable_by", "source"}
SHOWN = {"text", "label", "title", "aria-label", "value", "model-value", "options", "innerHTML"}
SHOWN |= {"data-parameter", "effects", "alt"}
MARKUP = {"div", "span", "b", "i", "u", "em", "ul", "li", "br"}
MARKED = {"class", "style", "title", "data-error", "data-rough"}


def hostile(content, key=""):
    """The same with every text replaced that is not needed to find it."""
    if isinstance(content, dict):
        return {name: hostile(value, name) for name, value in content.items()}
    if isinstance(content, list):
        return [hostile(value, key) for value in content]
    return f"{key}: {HOSTILE}" if isinstance(content, str) and key not in FIXED else content


class Markup(HTMLParser):
    """What tags and attributes some HTML has."""

    def handle_starttag(self, tag, attrs):
        assert tag in MARKUP
        assert {name for name, _ in attrs} <= MARKED


def keys_of(content, path=()) -> Iterator[tuple[str, ...]]:
    """The path of each text that bears the mark; none is part of a key."""
    if isinstance(content, dict):
        for name, value in content.items():
            assert MARK not in str(name)
            yield from keys_of(value, (*path, str(name)))
    elif isinstance(content, list | tuple):
        for value in content:
            yield from keys_of(value, path)
    elif isinstance(content, str) and MARK in content:
        if path[-1] == "innerHTML":
            Markup().feed(content)
        yield path


def shown(state, folder) -> str:
    """All elements of the page as it is sent, once it is known that none is more than its properties."""

    async def built():
        core.loop = asyncio.get_running_loop()
        home = AppState(folder)
        home.state = state
        with Client(page("")) as client:
            await lay_out_page(home)
        return [element._to_dict() for element in client.elements.values()]

    elements = asyncio.run(built())
    for element in elements:
        assert not [key for key in element.get("props", {}) if key.startswith((":", "on"))]
        assert not [event for event in element.get("events", ()) if event["js_handler"]]
        for path in keys_of(element):
            assert path[0] in {"text", "props"}
            assert SHOWN & set(path[:2])
    return str(elements)


def forged(content: dict) -> dict:
    """What was changed, with the checksum that whoever wants to deceive writes."""
    return with_checksum({key: value for key, value in content.items() if key != "sha256"})


def keep_diagnosis(data, folder) -> None:
    """Keep a diagnosis of a data file with every kind of text that it may have, and revisions."""
    with pytest.MonkeyPatch.context() as patch:
        try_few_effects(patch)
        study = Study(data, folder=folder)
        found = study.diagnose(apply=True)
    following = {"purpose": "tell", "separates": ["bias"], "instruction": "go", "probe": {}}
    content = study.diagnosis_data(found)
    content["channels"][0] |= {"next_experiment": following, "depends_on": ["time"], "warnings": ["odd"]}
    (folder / RESULT).write_text(json.dumps(forged(content)))


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """What opens a study of which a diagnosis and revisions are kept, and their folder."""
    folder = tmp_path_factory.mktemp("diagnosed")
    data = write_presses(folder / "press.csv")
    keep_diagnosis(data, folder)
    return lambda: WorkbenchState(Study(data, folder=folder), "press.csv"), folder


@contextmanager
def changed(file, change):
    kept = file.read_text()
    file.write_text(json.dumps(forged(change(json.loads(kept)))))
    yield
    file.write_text(kept)


def test_every_text_of_a_saved_diagnosis_is_escaped(diagnosed, tmp_path):
    state, folder = diagnosed
    with changed(folder / RESULT, hostile):
        said = shown(state(), tmp_path)
    assert f"Next: instruction: {MARK}" in said
    assert f", to purpose: {MARK}" in said
    assert f"effect: {MARK}" in said


def test_every_text_of_a_saved_revision_is_escaped(diagnosed, tmp_path):
    state, folder = diagnosed
    file = folder / "revisions" / "0001.json"

    def spoil(content):
        for parameter in content["parameters"].values():
            parameter["unit"] = HOSTILE
        return content | dict.fromkeys(("effort_unit", "created_utc", "software_version"), HOSTILE)

    with changed(file, spoil):
        assert MARK in shown(state(), tmp_path)


def test_names_of_files_and_columns_are_escaped(tmp_path):
    name = HOSTILE.replace("/", "_")
    data = write_presses(tmp_path / f"{name}.csv")
    column = HOSTILE.replace('"', '""')
    data.write_text(data.read_text().replace("force_N", f'"Fz {column} [N]"', 1))
    state = WorkbenchState(
        Study(data, columns={"force": f"Fz {HOSTILE} [N]"}, units={"force": "N"}, keep=False), name
    )
    assert name[:20] in shown(state, tmp_path)
    assert MARK in shown(None, tmp_path)  # offered where nothing is open


def test_every_text_of_a_session_is_escaped(probed, tmp_path):
    session = Session.open(probed[0])
    told = session.metadata
    texts = {"software_version": HOSTILE, "command_line": f"palpate probe --robot '{MARK}'", "seed": None}
    extra = {name: HOSTILE if name != "plan" else text for name, text in told.extra.items()}
    metadata = type(told)(**{**vars(told), **texts, "extra": {**extra, "source": f"simulated {HOSTILE}"}})
    samples = [session.samples(name) for name in session.stream_names]
    streams = [
        (one.stream, {column.name: one[column.name] for column in one.stream.columns}) for one in samples
    ]
    file = write_session(tmp_path / "theirs.mcap", streams, metadata, session.events)
    shown(WorkbenchState(Study(file, keep=False), "theirs.mcap"), tmp_path)


def test_text_of_a_refused_file_is_escaped(tmp_path):
    async def built():
        core.loop = asyncio.get_running_loop()
        with Client(page("")) as client:
            await lay_out_page(AppState(tmp_path, error=HOSTILE))
        return [element._to_dict() for element in client.elements.values()]

    assert [path for one in asyncio.run(built()) for path in keys_of(one)] == [("text",)]


def test_page_sets_texts_by_key_alone():
    """What `props` and `classes` read as code are constants, and markup is sanitized by the browser."""
    folder = Path(palpate.__file__).parent / "workbench"
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                where = f"{file.name}:{node.lineno}"
                if node.func.attr in {"props", "style", "run_javascript", "add_css"}:
                    constant = [
                        isinstance(a, ast.Constant) or getattr(a, "id", "").isupper() for a in node.args
                    ]
                    assert all(constant), where
                assert not [one.arg for one in node.keywords if one.arg in {"sanitize", "js_handler"}], where
    assert "v-html" not in (folder / "effects.js").read_text().replace(
        "v-html=\"row.picture || 'about'\"", ""
    )
