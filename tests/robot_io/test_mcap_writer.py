"""Files written from whole arrays, beside those of the library that writes message by message."""

from io import BytesIO

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from robot_io.session.mcap_writer import McapWriter


def batches(sizes):
    """Channel, numbers, times and messages of some batches of two channels, the times in no order."""
    rng, number = np.random.default_rng(1), 0
    for index, size in enumerate(sizes):
        channel = 1 + index % 2
        messages = rng.integers(0, 4, (size, 20 + 30 * channel), dtype=np.uint8)
        times_ns = rng.integers(0, 10**9, size).astype(np.uint64)
        yield channel, np.arange(number, number + size, dtype=np.uint64), times_ns, messages
        number += size


def by_the_library(sizes, chunk_bytes, ended):
    file = BytesIO()
    mcap = Writer(file, chunk_size=chunk_bytes, compression=CompressionType.LZ4, enable_data_crcs=True)
    mcap.start(profile="palpate")
    mcap.add_metadata("first", {"a": "b"})
    for name in ("one", "two"):
        schema = mcap.register_schema(f"of.{name}", "protobuf", name.encode())
        mcap.register_channel(name, "protobuf", schema, {"unit": "N"})
    for batch in batches(sizes):
        channel, sequence, times_ns, messages = batch
        for number, time_ns, message in zip(sequence, times_ns, messages, strict=True):
            data, time = message.tobytes(), int(time_ns)
            mcap.add_message(channel, time, data, time, sequence=int(number))
        if ended:
            mcap.flush()
    mcap.add_metadata("last", {})
    mcap.finish()
    return file.getvalue()


def by_arrays(sizes, chunk_bytes, ended):
    file = BytesIO()
    mcap = McapWriter(file, "palpate", chunk_bytes)
    mcap.add_metadata("first", {"a": "b"})
    for name in ("one", "two"):
        mcap.register_channel(name, f"of.{name}", "protobuf", name.encode(), {"unit": "N"})
    for batch in batches(sizes):
        mcap.add_messages(*batch)
        if ended:
            mcap.end_chunk()
    mcap.add_metadata("last", {})
    mcap.finish()
    return file.getvalue()


@pytest.mark.parametrize("ended", [False, True])
@pytest.mark.parametrize("chunk_bytes", [1, 500, 4000, 10**6])
@pytest.mark.parametrize("sizes", [[], [0], [1], [3, 200, 1, 1, 57]])
def test_every_byte_is_as_the_library_writes_it(sizes, chunk_bytes, ended):
    assert by_arrays(sizes, chunk_bytes, ended) == by_the_library(sizes, chunk_bytes, ended)
