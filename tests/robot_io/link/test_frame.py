"""Frames: unchanged on arrival, and refused if damaged or meaningless."""

import json
from math import inf, nan

import pytest

from palpate.robot_io.errors import InputError
from palpate.robot_io.link.frame import (
    CHECKSUM,
    MOST_BYTES,
    FrameCode,
    FrameError,
    LastReceived,
    decode,
    encode,
    key_seal,
    load_seal,
)
from palpate.robot_io.link.messages import ContactModel, EstimatedParameter, Target, target_number
from tests.robot_io.link.link_parts import estimate, intent, report, target

MESSAGES = [
    intent(target(), target(7, 0.44), cancelled=(3,), ended=True),
    report(remark="µ"),
    estimate(noise_n=nan),
]


def framed(message, sequence: int = 5, seal: FrameCode = CHECKSUM) -> bytes:
    return encode(2**61 + 3, sequence, 1.25, LastReceived(2**60 + 1, nan, 7.5), message, seal)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: type(one).__name__)
def test_message_arrives_unchanged(message):
    frame = decode(framed(message))
    assert repr(frame.message) == repr(message)  # as it holds NaN
    assert (frame.sender, frame.sequence, frame.sent_s, frame.heard_at_s) == (2**61 + 3, 5, 1.25, 7.5)
    assert frame.heard_sent_s != frame.heard_sent_s


def test_frames_of_another_version_are_refused_by_name(monkeypatch):
    with monkeypatch.context() as newer_program:
        newer_program.setattr("palpate.robot_io.link.frame.VERSION", 5)
        newer = framed(MESSAGES[0])
    with pytest.raises(FrameError, match="version 5 of the messages; this program supports version 4"):
        decode(newer)


OURS, THEIRS = key_seal(b"k" * 32), key_seal(b"k" * 31 + b"l")


@pytest.mark.parametrize(
    ("made", "read", "words"),
    [
        (THEIRS, OURS, "not made with this side's key"),
        (CHECKSUM, OURS, "not made with this side's key"),
        (OURS, CHECKSUM, "made with a key"),
    ],
)
def test_connection_with_another_key_is_refused(made, read, words):
    assert decode(framed(MESSAGES[0], seal=made), made).message == MESSAGES[0]
    with pytest.raises(FrameError, match=words):
        decode(framed(MESSAGES[0], seal=made), read)


def test_signature_matches_rfc_4231():
    """Its second test case."""
    assert key_seal(b"Jefe").of(b"what do ya want for nothing?").hex() == "5bdcc146bf60754e6a042426089575c7"


@pytest.mark.parametrize("size", [None, 0, 15, 4097])
def test_invalid_key_file_is_refused(size, tmp_path):
    path = tmp_path / "pair.key"
    if size is not None:
        path.touch(0o600)
        path.write_bytes(bytes(size))
    with pytest.raises(InputError, match=r"pair\.key"):
        load_seal(path, "palpate/arm/leader")


def test_signature_holds_for_one_pair_and_one_direction(tmp_path):
    path = tmp_path / "pair.key"
    path.touch(0o600)
    path.write_bytes(b"k" * 32)
    said = load_seal(path, "palpate/arm/leader")
    opened = decode(framed(MESSAGES[0], seal=said), load_seal(path, "palpate/arm/leader"))
    assert opened.message == MESSAGES[0]
    for topic in ("palpate/arm/follower", "palpate/other/leader"):
        with pytest.raises(FrameError, match="this side's key"):
            decode(framed(MESSAGES[0], seal=said), load_seal(path, topic))


def test_frame_that_the_other_side_would_refuse_is_not_made():
    parameters = (EstimatedParameter("k" * 445, "", 0.0, 0.0, 0.0),) * 64
    rest = MOST_BYTES - len(framed(estimate(parameters=parameters, words="")))
    assert decode(framed(estimate(parameters=parameters, words="w" * rest)))
    with pytest.raises(InputError, match=f"ObjectEstimate of {MOST_BYTES + 1} bytes"):
        framed(estimate(parameters=parameters, words="w" * (rest + 1)))


@pytest.mark.parametrize("data", [b"", b"1234", bytes(MOST_BYTES + 1)])
def test_invalid_frame_is_refused(data):
    with pytest.raises(FrameError):
        decode(data)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Target(0, (0.4, nan, 0.05), (0.0, 0.0, -1.0)),
        lambda: Target(0, (0.4, 0.0, 1e9), (0.0, 0.0, -1.0)),
        lambda: Target(0, (0.4, 0.0), (0.0, 0.0, -1.0)),
        lambda: Target(0, (0.4, 0.0, 0.05), (0.0, 0.0, -0.9)),
        lambda: Target(2**47, (0.4, 0.0, 0.05), (0.0, 0.0, -1.0)),
        lambda: target_number(1, 2**16),
        lambda: Target(-1, (0.4, 0.0, 0.05), (0.0, 0.0, -1.0)),
        lambda: intent(target(1), target(1)),
        lambda: intent(*map(target, range(65))),
        lambda: report(force_n=inf),
        lambda: report(states=(2,)),
        lambda: report(states=(2, 99)),
        lambda: report(remark="x" * 501),
        lambda: estimate(model=()),
        lambda: estimate(surface_world_m=(nan, 0.0, 0.0)),
        lambda: ContactModel("kelvin_voigt", ("stiffness_n_m",), (nan,)),
        lambda: ContactModel("kelvin_voigt", ("stiffness_n_m",), ()),
    ],
)
def test_invalid_messages_cannot_be_made(make):
    with pytest.raises(InputError):
        make()


def test_invalid_message_is_refused_on_arrival(monkeypatch):
    with monkeypatch.context() as unchecked:
        unchecked.setattr(Target, "__post_init__", lambda self: None)
        sent = framed(intent(Target(0, (1e9, 0.0, 0.0), (0.0, 0.0, -1.0))))
    with pytest.raises(FrameError, match="target position"):
        decode(sent).message  # noqa: B018


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("entry", [None, {}, 9])
def test_message_of_many_invalid_entries_is_refused_in_one_short_line(message, entry):
    """Ten thousand errors held up the program for 0.15 s, and the reason had 24 kB."""
    frame = decode(framed(message))
    fields = json.loads(frame.content)
    for key in (key for key, value in fields.items() if isinstance(value, list)):
        content = json.dumps(fields | {key: 5000 * [entry]}).encode()
        with pytest.raises(FrameError) as raised:
            frame._replace(content=content).message  # noqa: B018
        assert len(str(raised.value)) <= 200
        assert raised.value.__cause__.error_count() < 10
