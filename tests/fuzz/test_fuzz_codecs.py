"""Every codec refuses damaged frames, and each check detects a faulty codec.

More inputs: PALPATE_FUZZ_INPUTS=1000000 pytest tests/fuzz/test_fuzz_codecs.py
"""

import builtins
import os
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings

from palpate.robot_io.drivers import moteus
from palpate.robot_io.drivers import odrive_protocol as odrive
from palpate.robot_io.drivers.dynamixel import protocol as dynamixel
from palpate.robot_io.drivers.feetech import protocol as feetech
from palpate.robot_io.drivers.mit import protocol as mit
from palpate.robot_io.drivers.serial_force import gauges, lorenz, microcontroller_cell, stream
from palpate.robot_io.errors import ProtocolError
from tests.fuzz.codecs import CODECS, Codec, run

SOON = 1600 if settings.default.max_examples < 100 else 4000  # as many in `make test-all`
INPUTS = int(os.environ.get("PALPATE_FUZZ_INPUTS", SOON))


@pytest.mark.parametrize("name", list(CODECS))
def test_damaged_frames_are_refused_without_crashes(name):
    result = run(CODECS[name], INPUTS, np.random.default_rng(1))
    assert not result.crashes
    assert not result.wrong
    assert result.accepted > INPUTS // 50  # it is not simply deaf


class Anything:
    """Equal to everything."""

    def __eq__(self, other):
        return True

    def __ne__(self, other):
        return False

    __hash__ = None


class AnyPair(Anything, tuple):
    """And a pair, for `==` to look no further."""


BREAKS = [  # a codec, and how it is broken: module, name there, what replaces it
    ("dynamixel_packet", dynamixel, "_STUFFED", lambda old: b"never"),
    ("dynamixel_stream", dynamixel, "_STUFFED", lambda old: b"never"),
    ("dynamixel_packet", dynamixel, "_STATUS", lambda old: Anything()),  # so is an instruction
    ("dynamixel_stream", dynamixel, "_STATUS", lambda old: Anything()),
    ("dynamixel_packet", dynamixel, "_checksum", lambda old: lambda data: Anything()),
    ("dynamixel_fast_reply", dynamixel, "_checksum", lambda old: lambda data: Anything()),
    ("feetech_packet", feetech, "WHOLE_SUM", lambda old: Anything()),
    ("feetech_stream", feetech, "WHOLE_SUM", lambda old: Anything()),
    ("feetech_packet", feetech, "LARGEST_ID", lambda old: 0xFE),  # so is an echo
    ("feetech_stream", feetech, "LARGEST_ID", lambda old: 0xFE),
    ("mit", mit, "_MAX_12", lambda old: 4096),
    ("mit", mit, "from_bits", lambda old: lambda bits, half, largest: -old(bits, half, largest)),
    ("mit", mit, "expect_length", lambda old: lambda *args: None),
    ("mit_robstride", mit, "_FOUR_WORDS", lambda old: struct.Struct("<4H")),
    ("mit_robstride", mit, "_MODE_COUNT", lambda old: 4),
    ("mit_robstride", mit.RobstrideFrames, "sender", lambda old: lambda frames, frame: 1),
    ("moteus", moteus, "_HEADS", lambda old: Anything()),
    ("moteus", moteus, "_ANSWER", lambda old: struct.Struct(">2sb2s3f3s4b")),
    ("moteus", moteus, "isfinite", lambda old: lambda value: True),
    ("moteus", moteus, "_VOLTS_PER_COUNT", lambda old: 0.1),
    ("odrive", odrive, "isfinite", lambda old: lambda value: True),
    ("odrive", odrive, "decode_two_floats", lambda old: lambda *args: old(*args)[::-1]),
    ("odrive", odrive, "_WORD", lambda old: struct.Struct(">I")),
    ("lorenz_telegram", lorenz, "checksums", lambda old: lambda content: AnyPair()),
    (
        "microcontroller_cell",
        microcontroller_cell,
        "verified_text",
        lambda old: lambda line: line.decode("latin1"),
    ),
    ("mark10", gauges, "_READING", lambda old: re.compile(r"([+-]?[0-9.]+) ?([A-Za-z]*).*")),
    ("mark10", gauges, "newtons_per", lambda old: lambda unit: 2.0),
    ("loadstar", stream, "float", lambda old: lambda number: 10.0 * float(number)),
]


def is_found_out(name):
    """Whether any of 4000 inputs shows that the codec is broken; ends soon after the first that does."""
    rng = np.random.default_rng(1)
    return any(run(CODECS[name], 500, rng).wrong for _ in range(8))


@pytest.mark.parametrize(("name", "codec", "part", "broken"), BREAKS, ids=[f"{b[0]}-{b[2]}" for b in BREAKS])
def test_fuzzer_detects_a_faulty_codec(name, codec, part, broken, monkeypatch):
    whole = getattr(codec, part, None) or getattr(builtins, part)  # a builtin is shadowed in its module
    monkeypatch.setattr(codec, part, broken(whole), raising=False)
    assert is_found_out(name)


def test_fuzzer_detects_a_stream_that_ignores_its_counters(monkeypatch):
    """Three bytes are a sample, whatever they count."""

    def feed(self, data):
        buffer = self._unprocessed + data
        whole = len(buffer) // 3 * 3
        self._unprocessed = buffer[whole:]
        cut = (buffer[place + 1 : place + 3] for place in range(0, whole, 3))
        return [self._factor * int.from_bytes(value, "big", signed=True) for value in cut]

    monkeypatch.setattr(lorenz.LorenzStream, "feed", feed)
    assert is_found_out("lorenz_stream")


def test_fuzzer_detects_swapped_fields(monkeypatch):
    whole = mit.MitFrames.state

    def swap(frames, frame, ranges):
        state = whole(frames, frame, ranges)
        return replace(state, velocity_rad_s=2.0 * state.torque_nm, torque_nm=0.5 * state.velocity_rad_s)

    monkeypatch.setattr(mit.MitFrames, "state", swap)
    assert is_found_out("mit")


def test_fuzzer_detects_a_codec_without_validation():
    """It stumbles over an empty input, and refuses long ones."""

    def decode(data):
        if len(data) > 30:
            raise ProtocolError("too long")
        return [data[0]]

    gullible = Codec(
        lambda rng, number: b"\x01\x02", lambda: decode, lambda data, seen, value: data != b"\x01\x02"
    )
    result = run(gullible, 500, np.random.default_rng(0))
    assert result.wrong
    assert any("IndexError" in crash for crash in result.crashes)
    assert result.refused
