"""Saved files: a round trip, and refusal of foreign content."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.estimation.study.revisions import Revision
from palpate.estimation.study.saved_diagnosis import (
    MAX_BYTES,
    MAX_TEXT_LENGTH,
    clean_texts,
    read_saved,
    with_checksum,
)
from tests.revisions import revision


def texts_of(content, path=()):
    """The path of each text."""
    if isinstance(content, str):
        yield path
    for key, value in content.items() if isinstance(content, dict) else ():
        yield from texts_of(value, (*path, key))
    for place, value in enumerate(content if isinstance(content, list) else ()):
        yield from texts_of(value, (*path, place))


def changed(content, path, value):
    """The same with another value at a path."""
    if not path:
        return value
    made = content.copy()
    made[path[0]] = changed(content[path[0]], path[1:], value)
    return made


def written(tmp_path, content):
    file = tmp_path / "kept.json"
    file.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    return file


KEPT = revision(
    effects=["bias"], added="bias", user_effects=["mine.py:Mine"], effort_unit="N", data_sha256="ab"
).model_dump(mode="json")


STIFFNESS = KEPT["parameters"]["stiffness.k"]


def test_written_values_are_read(tmp_path):
    assert read_saved(written(tmp_path, with_checksum(KEPT)), Revision).model_dump(mode="json") == KEPT


@pytest.mark.parametrize("path", list(texts_of(KEPT)), ids=str)
def test_every_text_is_short(path, tmp_path):
    long = written(tmp_path, changed(KEPT, path, "a" * (MAX_TEXT_LENGTH + 1)))
    with pytest.raises(ValueError, match=f"^{'.'.join(map(str, path))}: has 4001 characters; at most 4000"):
        read_saved(long, Revision)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        *(
            (KEPT | {"model": text}, "model: .*cannot be printed")
            for text in ("a\nb: 5", "\x1b[2J", "\u202e")
        ),
        (KEPT | {"parameters": {"\x1b": STIFFNESS}}, "a key of parameters: .*cannot be printed"),
        (KEPT | {"model": 1.0}, "model: .*valid string"),
        (changed(KEPT, ("rmse",), "0.1"), "rmse: Input should be a valid number"),
        (KEPT | {"more\n": 1}, r"more\?: Extra"),
        (b"[" * 100_000, "nested too deeply"),
        (b"\xff\xfe", "Invalid JSON"),
        (b" " * (MAX_BYTES + 1), "more than 16 MB"),
        (b"", "Invalid JSON"),
    ],
)
def test_content_of_another_form_is_refused(content, why, tmp_path):
    with pytest.raises(ValueError, match=why) as caught:
        read_saved(written(tmp_path, content), Revision)
    assert str(caught.value).isprintable()


@settings(max_examples=25)
@given(
    st.recursive(
        st.text() | st.none() | st.floats(),
        lambda one: st.lists(one) | st.dictionaries(st.text(), one),
        max_leaves=10,
    )
)
def test_cleaned_content_has_nothing_else(content):
    made = clean_texts(content)
    assert all(text.isprintable() for text in _texts(made))
    assert clean_texts(made) == made or made != made


def _texts(content):
    if isinstance(content, str):
        yield content
    for each in (
        content if isinstance(content, list) else content.items() if isinstance(content, dict) else ()
    ):
        yield from _texts(list(each) if isinstance(each, tuple) else each)
