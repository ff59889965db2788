"""Lorenz telegrams and the stream that has nothing but a counter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_io.drivers.serial_force import lorenz_protocol as lorenz
from robot_io.drivers.serial_force.lorenz_protocol import (
    LorenzCommand,
    LorenzStream,
    Telegram,
    TelegramReader,
)
from robot_io.errors import InputError, ProtocolError

TELEGRAMS = st.builds(
    Telegram,
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, 255),
    st.lists(st.sampled_from([0, 1, 2, 3, 255]), max_size=20).map(bytes),
)


def test_a_telegram_summed_by_hand():
    """HELLO to 1 from 255: sums 40 41 40 40; weighted 40 81 C1, and 101 with its carry is 02, sent twice."""
    data = lorenz.encode_telegram(Telegram(LorenzCommand.HELLO, 1, 0xFF))
    assert data.hex() == "024001ff00" + "40" + "0202"


def test_the_stream_is_asked_for_with_its_rate_code():
    (telegram,) = TelegramReader().feed(lorenz.encode_start_stream(1, 1000))
    assert telegram == Telegram(0x5A, 1, 0xFF, bytes((3, 5, 0, 0, ord("A"))))
    with pytest.raises(InputError, match="valid are 20"):
        lorenz.encode_start_stream(1, 999)


@given(st.lists(TELEGRAMS, max_size=5), st.data())
def test_round_trip_in_any_portions(telegrams, data):
    rest, reader, found = b"".join(map(lorenz.encode_telegram, telegrams)), TelegramReader(), []
    while rest:
        cut = data.draw(st.integers(1, len(rest)))
        found += reader.feed(rest[:cut])
        rest = rest[cut:]
    assert found == telegrams
    assert reader.rejected == 0


@given(TELEGRAMS, st.data())
def test_a_flipped_bit_is_never_believed(telegram, data):
    encoded = bytearray(lorenz.encode_telegram(telegram))
    bit = data.draw(st.integers(0, 8 * len(encoded) - 1))
    encoded[bit // 8] ^= 1 << bit % 8
    assert telegram not in TelegramReader().feed(bytes(encoded))
    for other in TelegramReader().feed(bytes(encoded)):
        assert lorenz.encode_telegram(other) in bytes(encoded)


def test_a_telegram_that_lost_its_end_does_not_take_the_next_with_it():
    first, second = (lorenz.encode_telegram(Telegram(command, 1, 255, b"abc")) for command in (0x41, 0x42))
    reader = TelegramReader()
    assert [telegram.command for telegram in reader.feed(first[:6] + second)] == [0x42]
    assert reader.rejected == 1


@pytest.mark.parametrize("data", ["020201ff00020209", "42020201ff00020209", "020201ff02020202010718"])
def test_a_command_that_is_not_doubled_is_no_telegram(data):
    """Found by the fuzzer: the byte 02 right after STX belongs to a pair, or begins a telegram itself."""
    assert TelegramReader().feed(bytes.fromhex(data)) == []


def header_block(dimension=3, load=100):
    block = bytearray(28)
    block[0], block[8], block[10:12], block[4:8] = (
        0x40,
        dimension,
        load.to_bytes(2, "big"),
        (77).to_bytes(4, "big"),
    )
    sums = np.cumsum(np.frombuffer(block, np.uint8), dtype=np.int64)
    return (
        bytes((128,))
        + bytes(block)
        + int(sums[-1] % 65536).to_bytes(2, "big")
        + int(sums.sum() % 65536).to_bytes(2, "big")
    )


def test_the_sensor_header():
    header = lorenz.decode_header_block(header_block())
    assert (header.dimension_code, header.load_code, header.serial_number) == (3, 100, 77)
    for place in range(33):
        damaged = bytearray(header_block())
        damaged[place] ^= 0x10
        with pytest.raises(ProtocolError):
            lorenz.decode_header_block(damaged)


def samples(values, first_counter=0):
    return b"".join(
        bytes(((first_counter + i) % 256,)) + int(value).to_bytes(2, "big", signed=True)
        for i, value in enumerate(values)
    )


@given(st.integers(0, 255), st.lists(st.integers(-32768, 32767), min_size=10, max_size=300))
def test_the_stream_from_its_start(first_counter, values):
    assume_row = samples(values, first_counter)
    stream = LorenzStream(2.0)
    found = [sample for byte in assume_row for sample in stream.feed(bytes((byte,)))]
    wanted = [2.0 * value for value in values]
    start = next((k for k in range(len(wanted)) if wanted[k : k + len(found)] == found), None)
    assert start is not None  # a row
    assert len(found) >= len(wanted) - 6 or len(set(values)) < len(values)  # ambiguous ends may be left out


def test_a_lost_byte_costs_samples_and_gives_no_wrong_one():
    rng = np.random.default_rng(3)
    values = rng.integers(-20000, 20000, 400)
    data = samples(values)
    for place in range(300, 330):
        stream = LorenzStream(1.0)
        found = stream.feed(data[:place] + data[place + 1 :])
        wrong = set(found) - set(values.tolist())
        assert not wrong
        assert found[-200:] == values[-200:].tolist()
        assert stream.rejected >= 1


def test_a_ramp_is_not_taken_for_the_counter():
    """A force that grows by one count a sample counts on too."""
    values = np.arange(200)
    data = samples(values, first_counter=100)[1:]  # joined in the middle of a sample
    found = LorenzStream(1.0).feed(data)
    assert set(found) <= set(values.tolist())
