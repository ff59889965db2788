import numpy as np
import pytest
from hypothesis import given

from robot_io.errors import InputError, SessionError
from robot_io.session.stream import Column, Stream, streams_from_json, streams_to_json
from tests.robot_io.session_parts import streams

TIME = Column("time_s", "s")
PAIR = Stream("pair", (TIME, Column("tip_m", "m", 3), Column("count", "1", 1, "", "int32")))


def flags(count, width=1):
    return (Column(f"flag_{i}", "1", width, "", "bool") for i in range(count))


def test_the_largest_streams_are_taken():
    assert Stream("s", (TIME, *flags(1, 16_376))).dtype.itemsize == 16_384
    assert len(Stream("s" * 64, (TIME, *flags(999)), batch=16).columns) == 1000
    assert Column("x", "1", 16_384).shape == (16_384,)


def test_a_record_has_the_columns_in_order_without_gaps():
    assert PAIR.dtype.names == ("time_s", "tip_m", "count")
    assert PAIR.dtype.itemsize == 8 + 3 * 8 + 4
    assert PAIR.dtype["tip_m"].shape == (3,)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Column("9lives", "1"), "9lives"),
        (lambda: Column("a b", "1"), "a b"),
        (lambda: Column("x", "1", 0), "width 0"),
        (lambda: Column("x", "1", 16_385), "width 16385 is not in 1..16384"),
        (lambda: Column("x" * 65, "1"), "at most 64"),
        (lambda: Column("x", "1", 1, "", "int8"), "int8"),
        (lambda: Column("x", "1", 1, "", "complex128"), "float64, float32"),
        (lambda: Column("x", "1", 1, "", "nonsense"), "nonsense"),
        (lambda: Stream("s", (Column("x", "m"),)), "time_s"),
        (lambda: Stream("s", (Column("time_s", "s", 2),)), "time_s"),
        (lambda: Stream("s", (TIME, Column("x", "m"), Column("x", "m"))), "x is there twice"),
        (lambda: Stream("s", (TIME, *flags(1, 16_377))), "a record of 16385 bytes, at most 16384"),
        (lambda: Stream("s", (TIME, *flags(8)), batch=1025), "1025 records of 16400 bytes"),
        (lambda: Stream("s", (TIME, *flags(1000))), "1001 columns, at most 1000"),
        (lambda: Stream("../s", (TIME,)), "../s"),
    ],
)
def test_what_cannot_be_a_stream_is_refused_by_name(make, word):
    with pytest.raises(InputError, match=word.replace(".", r"\.")):
        make()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"tip_m": None}, "missing: .*tip_m"),
        ({"more": [1.0, 2.0]}, "unknown: .*more"),
        ({"tip_m": np.zeros((2, 2))}, r"tip_m.*\(2, 2\), expected \(2, 3\)"),
        ({"count": [1]}, "count"),
        ({"count": [1.5, 2.0]}, "count.*float64 does not fit int32"),
        ({"tip_m": [[1], [1, 2]]}, "tip_m"),
        ({"count": ["a", "b"]}, "count"),
        ({"time_s": 0.5}, "time_s"),
        ({"time_s": [[0.0], [1.0]], "tip_m": np.zeros((2, 1, 3)), "count": [[1], [2]]}, "time_s"),
    ],
)
def test_columns_that_do_not_fit_are_refused_by_name(change, word):
    columns = {"time_s": [0.0, 1.0], "tip_m": np.zeros((2, 3)), "count": [1, 2]} | change
    with pytest.raises(InputError, match=word):
        PAIR.records({name: values for name, values in columns.items() if values is not None})


@given(streams("one"), streams("two"))
def test_streams_survive_their_description(one, two):
    assert streams_from_json(streams_to_json((one, two))) == (one, two)


@pytest.mark.parametrize(
    "text",
    [
        "", "[", "3", '[{"name": "a"}]', '[{"name": "a", "columns": [{"nam": 1}]}]', "[" * 100_000,
        '[{"name": "a", "columns": [{"name": "time_s", "unit": "s", "width": 1e9}]}]',
        '[{"name": 3, "columns": []}]',
    ],
)  # fmt: skip
def test_a_description_from_elsewhere_is_refused_in_one_way(text):
    with pytest.raises(SessionError):
        streams_from_json(text)
