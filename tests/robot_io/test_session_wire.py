from dataclasses import replace

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import assume, given
from hypothesis import strategies as st

from robot_io.errors import SessionError
from robot_io.session.stream import MAX_RECORD_BYTES, Column, Stream
from robot_io.session.wire import PACKAGE, WireFormat
from tests.robot_io.session_parts import TICK, streams_with_columns, ticks


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

    decoded = wire.decode(b"".join(messages))
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


@pytest.mark.parametrize("damage", [lambda m: m[:-1], lambda m: m + m[:5], lambda m: b"\x7a" + m[1:]])
def test_messages_of_another_form_are_refused(damage):
    wire = WireFormat(TICK)
    with pytest.raises(SessionError, match="tick"):
        wire.decode(damage(b"".join(wire.encode(ticks(range(3))))))
