"""What the documents tell readers to type into Python works as it stands there."""

import re
import shutil

import pytest

from tests.palpate.cli import ROOT

DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
EXAMPLES = [
    pytest.param(code, id=f"{path.name}-{number}")
    for path in DOCUMENTS
    for number, code in enumerate(
        re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL), 1
    )
]


@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_runs(few_effects, probed, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in re.findall(r'"(\w+\.mcap)"', code):
        shutil.copy(probed[0], name)
    exec(code, {})


def test_the_readme_and_the_session_format_have_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_what_a_document_points_to_is_there(path):
    links = re.findall(r"\]\(([^)#:]+)\)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (path.parent / link).exists()]
