"""Untrusted YAML: errors with their place, and no harm."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import YamlDocument, load_yaml, parse_yaml
from tests.files import saved


def test_yaml_values_are_plain_and_keys_know_their_lines():
    text = """
a: [1, -2.5, 1e3, 0x1F, true, null, ~, .inf]
b: [yes, off, 1:30, 2024-01-01, 012x, '7', "true"]
c:
"""
    document = parse_yaml(text, "f.yaml")
    assert document.data["a"] == [1, -2.5, 1000.0, 31, True, None, None, float("inf")]
    assert document.data["b"] == ["yes", "off", "1:30", "2024-01-01", "012x", "7", "true"]
    assert document.data["c"] is None
    document = parse_yaml("a: 1\n\n# note\nb:\n  c: 2\n  d:\n  - x: 1\n  - y\n", "f.yaml")
    assert document.line_of(("b",)) == 4
    assert document.line_of(("b", "c")) == 5
    assert document.line_of(("b", "d", 1)) == 8
    assert document.line_of(("b", "d", 1, "not there")) == 8
    assert document.line_of(("not there",)) == 1


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("a: 1\nb: 2\na: 3", 3, "the key 'a' appears twice"),
        ("a: {x: 1, 'x': 2}", 1, "the key 'x' appears twice"),
        ("a: &x [1]\nb: *x", 1, "anchor"),
        ("a: 1\nb: *x", 2, "alias"),
        ("a: !!python/object/apply:os.system ['true']", 1, "tag"),
        ("? [1, 2]\n: 3", 1, "plain word"),
        ("a: 1\n---\nb: 2", 2, "another document"),
        ("a: [1, 2", 1, "expected"),
        ("a:\n\t- 1", 2, "cannot start any token"),
        ('"\\ud800": 1', 1, "half of a surrogate pair"),
        ('a: 1\nb: ["x\\udfffy"]', 2, "half of a surrogate pair"),
        ("a: " + "[" * 50 + "]" * 50, 1, "nested deeper"),
        ('"\\e[2Jx\\ny": 1\n"\\e[2Jx\\ny": 2', 2, "appears twice"),  # a message cannot control the terminal
    ],
)
def test_invalid_yaml_is_refused_with_its_place(text, line, what):
    with pytest.raises(InputError, match=what) as caught:
        parse_yaml(text, "f.yaml")
    assert str(caught.value).startswith(f"f.yaml line {line}: ")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("text", "said"), [("[1, 2]", r"begins with '\[1, 2\]'"), ("word", "'word'"), ("3", "'3'")]
)
def test_top_must_be_keys(text, said):
    with pytest.raises(InputError, match=f"{said}, expected 'key: value' lines"):
        parse_yaml(text, "f.yaml")


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"absent\.yaml: cannot be read \(No such file"):
        load_yaml(tmp_path / "absent.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        load_yaml(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        load_yaml("nul\0.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")
    for endless in (tmp_path / "pipe.yaml", "/dev/zero"):
        with pytest.raises(InputError, match=r"(pipe\.yaml|/dev/zero): a device or a pipe, not a file"):
            load_yaml(endless)
    with pytest.raises(InputError, match=r"latin\.yaml: not UTF-8 text \(byte 6\)"):
        load_yaml(saved(tmp_path / "latin.yaml", b"a: caf\xe9"))


def test_size_is_bounded_before_parsing(tmp_path):
    with pytest.raises(InputError, match="larger than 999 bytes"):
        load_yaml(saved(tmp_path / "big.yaml", b"[" * 1000), max_bytes=999)
    with pytest.raises(InputError, match="larger than 999 bytes"):
        parse_yaml("[" * 1000, "f.yaml", max_bytes=999)


@given(st.text(alphabet="a1:-,.[]{}'\"&*!|>%@`?#~<=\\ \n\t\r\0\ufeff\x85é", max_size=60))
def test_any_text_is_a_document_or_an_input_error_on_one_line(text):
    try:
        document = parse_yaml(text, "f.yaml")
    except InputError as error:
        message = str(error)
    else:
        assert isinstance(document, YamlDocument)
        return
    assert message.startswith("f.yaml")
    assert "\n" not in message
