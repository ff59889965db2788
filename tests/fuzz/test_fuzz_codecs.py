"""A short run of benchmarks/fuzz_codecs.py, and that its judges can judge."""

import numpy as np
import pytest

from benchmarks.fuzzers import Fuzzer, all_fuzzers, run_fuzzer
from robot_io.errors import ProtocolError

INPUTS = 4000


@pytest.mark.parametrize("name", list(all_fuzzers()))
def test_damaged_frames_are_refused_and_nothing_else_happens(name):
    result = run_fuzzer(all_fuzzers()[name](), INPUTS, np.random.default_rng(1))
    assert not result.crashes
    assert not result.wrong
    assert result.accepted > INPUTS // 50  # it is not simply deaf


class Gullible(Fuzzer):
    """Believes everything, and stumbles over an empty input."""

    def frame(self, rng):
        return b"\x01\x02"

    def decode(self, data):
        if len(data) > 30:
            raise ProtocolError("too long")
        return [data[0]]

    def is_wrong(self, data, accepted):
        return data != b"\x01\x02"


def test_a_gullible_codec_is_found_out():
    result = run_fuzzer(Gullible(), 500, np.random.default_rng(0))
    assert result.wrong
    assert any("IndexError" in crash for crash in result.crashes)
    assert result.refused
