"""Channel checks, and results cached by array."""

from dataclasses import replace
from weakref import ref

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.signals import cache_by_array
from palpate.estimation.signals.blocks import block_index
from palpate.robot_io.errors import InputError
from tests.estimation.presses import session
from tests.estimation.swings import long_swings as swings


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"effort": np.ones(3)}, "effort has 3 samples"),
        ({"touching": np.ones(3, dtype=bool)}, "touching has 3 samples"),
        ({"context": {"temperature_c": np.full(15_000, np.nan)}}, "temperature_c is not finite at sample 0"),
    ],
)
def test_arrays_of_other_lengths_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        replace(swings(1, rate_hz=1000.0), **change)


def test_results_are_cached_for_read_only_arrays():
    asked = []
    total = cache_by_array.cache_by_array(
        lambda *arrays: asked.append(arrays) or sum(one.sum() for one in arrays)
    )
    mine, fixed = np.arange(4.0), np.arange(4.0)
    fixed.setflags(write=False)
    assert [total(one) for one in (mine, mine, fixed, fixed)] == [6.0] * 4
    assert len(asked) == 3
    fixed.setflags(write=True)
    fixed[0] = 4.0
    assert total(fixed) == 10.0
    assert not any(one.flags.writeable for one in block_index(np.repeat([0, 1], 2)))


def test_tool_compliance_follows_the_current_contact():
    """The force is smoothed piece by piece; where the surface moves, the pieces do."""
    compliance, data = EFFECTS["tool_compliance"](), swings(1, rate_hz=1000.0)
    data = replace(data, kind=ChannelKind.CONTACT)
    moved = replace(data, position=data.position + 0.3)
    compliance.move(data, {"compliance": 1e-3})
    after = compliance.move(moved, {"compliance": 1e-3})
    fresh = compliance.move(replace(moved, effort=moved.effort.copy()), {"compliance": 1e-3})
    np.testing.assert_array_equal(after.velocity, fresh.velocity)


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
