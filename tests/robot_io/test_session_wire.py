import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given

from robot_io.errors import SessionError
from robot_io.session.wire import PACKAGE, WireFormat
from tests.robot_io.session_parts import TICK, streams_with_columns, ticks


def parsed_by_protobuf(wire, messages):
    """What protobuf's own parser makes of the messages, with nothing but the descriptor beside them."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(wire.descriptor_set()).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{wire.stream.name}"))
    return [kind.FromString(message) for message in messages]


@given(streams_with_columns())
def test_protobuf_and_decode_both_read_what_was_encoded(stream_and_columns):
    stream, columns = stream_and_columns
    wire = WireFormat(stream)
    messages = [message.tobytes() for message in wire.encode(stream.records(columns))]

    decoded = wire.decode(b"".join(messages))
    for name, values in columns.items():
        assert decoded[name].tobytes() == values.tobytes()

    for row, message in enumerate(parsed_by_protobuf(wire, messages)):
        for column in stream.columns:
            value = getattr(message, column.name)
            got = np.array(value if column.width == 1 else list(value), column.dtype)
            np.testing.assert_array_equal(got, columns[column.name][row])


@pytest.mark.parametrize("damage", [lambda m: m[:-1], lambda m: m + m[:5], lambda m: b"\x7a" + m[1:]])
def test_messages_of_another_form_are_refused(damage):
    wire = WireFormat(TICK)
    with pytest.raises(SessionError, match="tick"):
        wire.decode(damage(wire.encode(ticks(range(3))).tobytes()))
