"""Which of two pairs is named, where both explain all: the simpler one, if nothing speaks for the other."""

from types import SimpleNamespace

import pytest

from estimation.channel import ChannelKind
from estimation.diagnosis.search import together


def fitted(held_out, rmse):
    """A model of a joint that leaves this energy on blocks, and this error sample by sample."""
    return SimpleNamespace(
        trial=SimpleNamespace(held_out=held_out), rmse=rmse, data=SimpleNamespace(kind=ChannelKind.REVOLUTE)
    )


def named(monkeypatch, simple, rich):
    """The pair that comes out where a pair of three parameters and one of six explain all."""
    trials = (SimpleNamespace(model=end, parameters={}) for end in (simple, rich))
    names = (("coulomb_friction", 3), ("asymmetric_friction", 6))
    pairs = [
        SimpleNamespace(one="payload", other=other, size=size, trial=trial)
        for (other, size), trial in zip(names, trials, strict=True)
    ]
    search = SimpleNamespace(stand_anew=lambda model, parameters: model, is_explained=lambda end: True)
    monkeypatch.setattr(together, "promising_pairs", lambda search: pairs)
    monkeypatch.setattr(together, "confirmed", lambda search, end, names: tuple(names))
    return together.pair(search)


@pytest.mark.parametrize(
    ("rich", "expected"),
    [
        (fitted(1.99, 0.0999), "coulomb_friction"),  # as good on blocks: nothing speaks for more parameters
        (fitted(1.50, 0.0970), "coulomb_friction"),  # better, but no effect is accepted for so little
        (fitted(1.50, 0.0940), "asymmetric_friction"),
    ],
)
def test_more_parameters_must_take_away_what_an_effect_has_to(monkeypatch, rich, expected):
    assert named(monkeypatch, fitted(2.0, 0.1), rich) == ("payload", expected)
