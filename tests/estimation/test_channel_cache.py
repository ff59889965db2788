"""Results by channel are computed once, but do not keep the samples of very long channels alive."""

from dataclasses import replace
from weakref import ref

import numpy as np
import pytest

from palpate.estimation.signals import cache_by_array
from tests.estimation.presses import session


@pytest.mark.parametrize(("limit", "is_kept"), [(10**6, True), (100, False)])
def test_only_channels_of_limited_length_are_cached(monkeypatch, limit, is_kept):
    monkeypatch.setattr(cache_by_array, "_MAX_SAMPLES", limit)
    computed = []

    @cache_by_array.cache_by_channel_arrays("position")
    def largest(data):
        computed.append(data.name)
        return float(np.max(data.position))

    pressed = session(1)
    assert len(pressed) > 100
    assert (
        largest(pressed) == largest(replace(pressed, effort=2.0 * pressed.effort)) == pressed.position.max()
    )
    assert len(computed) == (1 if is_kept else 2)
    held = ref(pressed)
    del pressed
    assert (held() is not None) == is_kept
