"""The rehearsal of an effect lets every effect pass that is sound: all of palpate's own are."""

from dataclasses import replace

import pytest

from estimation.channel import ChannelKind
from estimation.effects import EFFECTS
from palpate.user_effects.guard import rehearse, watched
from tests.estimation.presses import kelvin_voigt, session

DATA = session(1, lambda t, x, v, run: kelvin_voigt(x, v))


@pytest.mark.parametrize("kind", ChannelKind)
@pytest.mark.parametrize("name", EFFECTS)
def test_palpates_own_effects_pass(name, kind):
    rehearse(watched(EFFECTS[name]()), replace(DATA, kind=kind))
