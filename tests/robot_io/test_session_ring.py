"""Streams, their ring in shared memory and their bytes."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session.shared_log import RingBuffer
from palpate.robot_io.session.stream import (
    MAX_RECORD_BYTES,
    Column,
    Stream,
    streams_from_json,
    streams_to_json,
)
from palpate.robot_io.session.wire import PACKAGE, Decoder, WireFormat
from tests.robot_io.session_parts import TICK, streams, streams_with_columns, ticks

DTYPE = np.dtype([("a", "<i8"), ("b", "<f8", (30,))])


def ring_of(slots):
    return RingBuffer(memoryview(bytearray(RingBuffer.size_bytes(DTYPE, slots))), DTYPE, slots)


def record(number):
    return (number, np.full(30, number))


@given(
    st.integers(1, 7), st.lists(st.tuples(st.sampled_from(["push", "pop"]), st.integers(1, 9)), max_size=60)
)
def test_ring_buffer_counts_dropped_records(slots, steps):
    ring, model, offered, dropped = ring_of(slots), [], 0, 0
    for step, count in steps:
        if step == "push":
            for _ in range(count):
                if len(model) < slots:
                    model.append(offered)
                else:
                    dropped += 1
                ring.push(record(offered))
                offered += 1
        else:
            taken = []
            while len(taken) < count and (got := ring.pop(count - len(taken)))[1].size:
                np.testing.assert_array_equal(got[0], got[1]["a"])
                taken += got[1]["a"].tolist()
            assert taken == model[:count]
            del model[:count]
        assert (ring.dropped, ring.offered, ring.full) == (dropped, offered, len(model) == slots)


def test_record_of_the_wrong_form_leaves_no_trace():
    ring = ring_of(4)
    ring.push(record(0))
    for wrong in [(1,), (1, np.zeros(29)), ("x", np.zeros(30))]:
        try:
            ring.push(wrong)
        except (TypeError, ValueError):
            continue
        raise AssertionError(f"{wrong} was taken")
    ring.push(record(1))
    assert ring.pop(9)[1]["a"].tolist() == [0, 1]
    assert ring.dropped == 0


def test_records_are_whole_while_both_sides_are_busy():
    memory, slots, count = bytearray(RingBuffer.size_bytes(DTYPE, 8)), 8, 300
    incoming, ring = (RingBuffer(memoryview(memory), DTYPE, slots) for _ in range(2))

    def produce():
        for number in range(count):
            while incoming.full:
                time.sleep(0)
            incoming.push(record(number))

    producer = threading.Thread(target=produce)
    producer.start()
    sequences = []
    while producer.is_alive() or ring.taken < ring.offered:
        sequence, records = ring.pop(5)
        np.testing.assert_array_equal(
            records["b"], np.broadcast_to(records["a"][:, None], records["b"].shape)
        )
        np.testing.assert_array_equal(sequence, records["a"])
        sequences += sequence.tolist()
    assert sequences == list(range(count))
    assert ring.dropped == 0


def parsed_by_protobuf(wire, messages):
    """What protobuf's own parser makes of the messages, with nothing but the descriptor beside them."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(wire.descriptor_set()).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{wire.stream.name}"))
    return [kind.FromString(message) for message in messages]


@given(streams_with_columns(), st.sampled_from([1, 1, 2, 7]))
def test_protobuf_and_decode_both_read_what_was_encoded(stream_and_columns, batch):
    stream, columns = stream_and_columns
    assume(batch * stream.dtype.itemsize <= MAX_RECORD_BYTES)
    wire = WireFormat(replace(stream, batch=batch))
    messages = wire.encode(stream.records(columns))
    assert len(messages) == -(-len(columns["time_s"]) // batch)

    decoder = Decoder(wire, sum(map(len, messages)))
    for message in messages:
        decoder.add(message)
    # Columns may be asked for again, and are the same.
    for decoded in (wire.decode(b"".join(messages)), decoder.columns(), decoder.columns()):
        for name, values in columns.items():
            assert decoded[name].tobytes() == values.tobytes()

    for number, message in enumerate(parsed_by_protobuf(wire, messages)):
        for column in stream.columns:
            value, rows = getattr(message, column.name), slice(number * batch, (number + 1) * batch)
            got = np.array(list(value) if column.width * batch > 1 else [value], column.dtype)
            np.testing.assert_array_equal(got, columns[column.name][rows].ravel())


@pytest.mark.parametrize("width", [1, 2, 127, 128, 16_000])
def test_protobuf_writes_the_same_bytes(width):
    stream = Stream("s", (Column("time_s", "s"), Column("flag", "1", width, "", "bool")))
    flags = np.ones((1, width) if width > 1 else 1, bool)
    (message,) = WireFormat(stream).encode(stream.records({"time_s": [1.0], "flag": flags}))
    (parsed,) = parsed_by_protobuf(WireFormat(stream), [message])
    assert parsed.SerializeToString(deterministic=True) == message


@pytest.mark.parametrize(
    "damage",
    [
        lambda m: m[:-1],
        lambda m: m + m[:5],
        lambda m: b"\x7a" + m[1:],
        lambda m: m[: len(m) // 3] + b"\x7a" + m[len(m) // 3 + 1 :],
    ],
    ids=["too short", "too long", "first", "second"],
)
def test_messages_of_another_form_are_refused(damage):
    wire = WireFormat(TICK)
    with pytest.raises(SessionError, match="tick"):
        wire.decode(damage(b"".join(wire.encode(ticks(range(3))))))


TIME = Column("time_s", "s")
PAIR = Stream("pair", (TIME, Column("tip_m", "m", 3), Column("count", "1", 1, "", "int32")))


def flags(count, width=1):
    return (Column(f"flag_{i}", "1", width, "", "bool") for i in range(count))


def test_record_has_the_columns_in_order_and_the_largest_streams_fit():
    assert Column("x", "m", dtype=np.int32) == Column("x", "m", dtype="int32")
    assert Stream("s", (TIME, *flags(1, 16_376))).dtype.itemsize == 16_384
    assert len(Stream("s" * 64, (TIME, *flags(999)), batch=16).columns) == 1000
    assert Column("x", "1", 16_384).shape == (16_384,)
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
        (lambda: Stream("s", (TIME, Column("x", "m"), Column("x", "m"))), "x appears twice"),
        (lambda: Stream("s", (TIME, *flags(1, 16_377))), "a record of 16385 bytes, at most 16384"),
        (lambda: Stream("s", (TIME, *flags(8)), batch=1025), "1025 records of 16400 bytes"),
        (lambda: Stream("s", (TIME, *flags(1000))), "1001 columns, at most 1000"),
        (lambda: Stream("../s", (TIME,)), "../s"),
    ],
)
def test_invalid_stream_is_refused_by_name(make, word):
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
def test_mismatched_columns_are_refused_by_name(change, word):
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
def test_foreign_description_is_refused_in_one_way(text):
    with pytest.raises(SessionError):
        streams_from_json(text)
