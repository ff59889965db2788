"""Python examples, links and generated pages of the documentation."""

import os
import re
import shutil
import subprocess
import sys

import pytest
from rich.markup import render

from docs.make_commands import DOCUMENT, document
from palpate.commands import COMMANDS, load_command
from palpate.robot_io.files.file_model import load_yaml, parse_yaml
from tests.palpate.cli import ROOT, as_json

DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
EXAMPLES = [
    pytest.param(code, id=f"{path.parent.name}-{path.name}-{number}")
    for path in DOCUMENTS
    for number, code in enumerate(
        re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL), 1
    )
]


@pytest.mark.parametrize("code", EXAMPLES)
def test_example_runs(few_effects, without_figures, one_process, probed, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in re.findall(r'"(\w+\.mcap)"', code):
        shutil.copy(probed[0], name)
    exec(code, {})


def test_readme_and_session_format_have_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_document_links_exist(path):
    links = re.findall(r"\]\(([^)#:]+)\)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (path.parent / link).exists()]


def test_command_page_matches_the_help():
    """Otherwise run `.venv/bin/python docs/make_commands.py`."""
    assert DOCUMENT.read_text(encoding="utf-8") == document()


def test_terminal_shows_the_whole_help_of_each_option():
    """Rich takes a unit such as `[s]` for markup."""

    def helps(command):
        yield from (param.help or "" for param in command.params)
        yield from (text for child in getattr(command, "commands", {}).values() for text in helps(child))

    texts = [text for name in COMMANDS for text in helps(load_command(name))]
    assert [render(text).plain for text in texts] == texts


def test_site_builds_without_external_hosts(tmp_path):
    environment = {"NO_MKDOCS_2_WARNING": "1", **os.environ}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)
    assert result.returncode == 0, result.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > 40
    load = r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//[^>]*>"
    assert not [tag for page in pages for tag in re.findall(load, page.read_text(encoding="utf-8"))]


BY_NAME = ("parameters", "judged", "parts", "truth", "failures", "details")  # objects whose keys are names


def json_keys(value, by_name=False):
    """All keys in a result, without the names of parameters, channels and parts."""
    if isinstance(value, list):
        return set().union(*map(json_keys, value))
    if not isinstance(value, dict):
        return set()
    inner = (json_keys(child, key in BY_NAME and not by_name) for key, child in value.items())
    return set().union(() if by_name else value, *inner)


def test_json_page_has_every_key(few_effects, without_figures, hardening, tmp_path):
    page = (ROOT / "docs" / "reference" / "json.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`(\w+)`", page))
    diagnosis = json_keys(as_json("diagnose", hardening))
    assert diagnosis - documented == set()
    section = page.split("## diagnose")[1].split("\n## ")[0]
    columns = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", section, re.MULTILINE)
    assert set(re.findall(r"\w+", " ".join(columns))) - diagnosis == set()
    folder = ("--out", tmp_path / "models")
    assert json_keys(as_json("add", hardening, "cubic_stiffness", *folder)) - documented == set()
    for command in ("estimate", "compare"):
        assert json_keys(as_json(command, hardening)) - documented == set()


PAGE = ROOT / "docs" / "reference" / "robot-file.md"
ROBOT = ROOT / "robots" / "dynamixel_3dof.yaml"
PLAIN = """name urdf buses motors load_cell driver port id bus limits safe_state encoder torque force home_rad
    position_min_rad position_max_rad"""


def test_robot_file_page_shows_the_shipped_file_and_explains_its_keys():
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert parse_yaml("".join(blocks), str(PAGE)).data == load_yaml(ROBOT).data
    prose = re.sub(r"```yaml\n.*?```", "", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    keys = set(re.findall(r"(\w+):", re.sub(r"#.*", "", ROBOT.read_text(encoding="utf-8"))))
    plain = set(PLAIN.split())
    ages = {key for key in keys if key.endswith("_age_s")}
    assert "`_age_s`" in prose
    assert not [key for key in sorted(keys - plain - ages) if f"`{key}" not in prose]
