"""What a chain of effects does with one that nothing can take the place of."""

from types import SimpleNamespace

from estimation.diagnosis.search.chain import _reconsider


def test_a_step_stays_where_nothing_can_be_tried_in_its_place():
    standing = SimpleNamespace(trial=SimpleNamespace(held_out=1.0))
    worse = SimpleNamespace(trial=SimpleNamespace(held_out=9.0))
    search = SimpleNamespace(without=lambda end, name: worse, screen=lambda standing: [])
    steps = tuple(SimpleNamespace(effect=name, standing=standing) for name in ("bias", "drift"))
    assert _reconsider(search, steps) == steps
