"""Sealed answers: a round trip, and no accidental disclosure."""

import base64
import json
import resource
import signal
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError
from palpate.sim_backend.hidden import SealedAnswer, draw_hidden, seal, sealed_path, unseal
from palpate.sim_backend.imperfection import IMPERFECTIONS

MADE = "2025-01-02T03:04:05+00:00"


@given(st.lists(st.integers(0, 1000), max_size=4), st.none() | st.integers(0, 2**40))
def test_sealed_answer_is_read_back_unchanged(tmp_path_factory, seeds, seed):
    session = tmp_path_factory.mktemp("sealed") / "a.mcap"
    answer = SealedAnswer(tuple(draw_hidden(number)[0] for number in seeds), seed, MADE, "0f" * 16)
    path = seal(session, answer)
    assert path == sealed_path(session) == session.with_name("a.mcap.sealed")
    assert unseal(path) == answer
    assert [file.name for file in session.parent.iterdir()] == ["a.mcap.sealed"]


def test_sealed_file_tells_what_it_is_but_not_its_content(tmp_path):
    for name, kind in IMPERFECTIONS.items():
        channel = next((c for c in ("contact", "joint_1") if c in kind.shows_in), None)
        if channel is None:
            continue
        answer = SealedAnswer(tuple(draw_hidden(3, channel, effect=name)), 3, MADE)
        text = seal(tmp_path / f"{name}.mcap", answer).read_text()
        assert text.startswith("palpate sealed answer")
        assert "palpate reveal" in text
        body = text.split("\n", 2)[2]
        assert name not in body
        assert not [p.name for p in kind.parameters() if len(p.name) > 4 and p.name in body]


def test_second_answer_does_not_replace_the_first(tmp_path):
    session = tmp_path / "a.mcap"
    seal(session, SealedAnswer((), 1, MADE))
    with pytest.raises(InputError, match=r"a\.mcap\.sealed: already exists"):
        seal(session, SealedAnswer((), 2, MADE))
    assert unseal(sealed_path(session)).seed == 1


def test_sessions_with_different_endings_have_their_own_answers():
    assert len({sealed_path(f"ride{ending}") for ending in (".1.mcap", ".2.mcap", ".1.session", "")}) == 4


def test_answer_that_does_not_fit_on_the_disk_is_not_left_half_written(tmp_path):
    limit, before = resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(limit, (40, before[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"):
            seal(tmp_path / "a.mcap", SealedAnswer((), 1, MADE))
    finally:
        resource.setrlimit(limit, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def packed(data, title="palpate sealed answer, version 1"):
    code = base64.b64encode(zlib.compress(json.dumps(data).encode())).decode()
    return f"{title}\nhow\n\n{code}\n"


GOOD = {"hidden": [], "seed": 1, "made_utc": MADE}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not a sealed answer"),
        (packed(GOOD, "palpate sealed answer, version 2"), "not a sealed answer"),
        ("palpate sealed answer, version 1\nhow\n\n***\n", "damaged"),
        (packed(GOOD)[:-10], "damaged"),
        (packed({"seed": 1, "made_utc": MADE}), "damaged.*hidden"),
        (packed(GOOD | {"hidden": [{"effect": "gremlin"}]}), "damaged.*gremlin"),
        (packed(GOOD | {"seed": "x"}), "damaged.*wrong type"),
        (packed(GOOD | {"mark": 5}), "damaged.*wrong type"),
        (packed("0" * 3_000_000), "damaged.*larger than any answer"),
        (packed(GOOD) + "A" * 1_100_000, "damaged.*larger than 1000000 bytes"),
    ],
)
def test_damaged_file_is_one_clear_line(content, words, tmp_path):
    path = tmp_path / "a.sealed"
    path.write_text(content)
    with pytest.raises(InputError, match=words) as caught:
        unseal(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_missing_file_or_folder_is_one_clear_line(tmp_path):
    with pytest.raises(InputError, match=r"a\.mcap\.sealed: cannot be written"):
        seal(tmp_path / "no" / "a.mcap", SealedAnswer((), 1, MADE))
    with pytest.raises(InputError, match=r"a\.sealed: cannot be read"):
        unseal(tmp_path / "a.sealed")


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_in_one_line(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("sealed") / "a.sealed"
    path.write_bytes(b"palpate sealed answer, version 1\nhow\n\n" + content)
    with pytest.raises(InputError, match="damaged"):
        unseal(path)
