"""What a chain of effects does with one that nothing can take the place of."""

from types import SimpleNamespace

from estimation.diagnosis.search.chain import _reconsider, _settled

from estimation.diagnosis.search import chain


def test_a_step_stays_where_nothing_can_be_tried_in_its_place():
    standing = SimpleNamespace(trial=SimpleNamespace(held_out=1.0))
    worse = SimpleNamespace(trial=SimpleNamespace(held_out=9.0))
    search = SimpleNamespace(without=lambda end, name: worse, screen=lambda standing: [])
    steps = tuple(SimpleNamespace(effect=name, standing=standing) for name in ("bias", "drift"))
    assert _reconsider(search, steps) == steps


def test_an_effect_that_settled_before_another_was_there_is_looked_for_again(monkeypatch):
    poor, good = (SimpleNamespace(trial=SimpleNamespace(held_out=energy)) for energy in (9.0, 1.0))
    search = SimpleNamespace(
        is_explained=lambda standing: standing is good,
        elsewhere=lambda standing, name: good if name == "adhesion" else standing,
    )
    monkeypatch.setattr(
        chain,
        "confirmed",
        lambda search, end, names: tuple(SimpleNamespace(effect=name, standing=end) for name in names),
    )
    steps = tuple(SimpleNamespace(effect=name, standing=poor) for name in ("hysteresis", "adhesion"))
    settled = _settled(search, steps)
    assert [step.effect for step in settled] == ["hysteresis", "adhesion"]
    assert settled[-1].standing is good
    assert _settled(search, steps[:1]) == steps[:1]
