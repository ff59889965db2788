from dataclasses import replace

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import assume, given
from hypothesis import strategies as st

from robot_io.errors import SessionError
from robot_io.session.stream import MAX_RECORD_BYTES
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


@pytest.mark.parametrize("damage", [lambda m: m[:-1], lambda m: m + m[:5], lambda m: b"\x7a" + m[1:]])
def test_messages_of_another_form_are_refused(damage):
    wire = WireFormat(TICK)
    with pytest.raises(SessionError, match="tick"):
        wire.decode(damage(b"".join(wire.encode(ticks(range(3))))))
