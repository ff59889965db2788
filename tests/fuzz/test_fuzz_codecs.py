"""Every codec refuses damaged frames.

More inputs: PALPATE_FUZZ_INPUTS=1000000 pytest tests/fuzz/test_fuzz_codecs.py
"""

import os

import numpy as np
import pytest
from hypothesis import settings

from tests.fuzz.codecs import CODECS, run

SOON = 1600 if settings.default.max_examples < 100 else 4000  # as many in `make test-all`
INPUTS = int(os.environ.get("PALPATE_FUZZ_INPUTS", SOON))


@pytest.mark.parametrize("name", list(CODECS))
def test_damaged_frames_are_refused_without_crashes(name):
    result = run(CODECS[name], INPUTS, np.random.default_rng(1))
    assert not result.crashes
    assert not result.wrong
    assert result.accepted > INPUTS // 50  # it is not simply deaf
