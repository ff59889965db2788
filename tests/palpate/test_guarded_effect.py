"""An effect of the user's own that is sound at one place and not at another, where a search calls it."""

import numpy as np
import pytest

from estimation.channel import ChannelKind
from estimation.effect import AdditiveEffect, Parameter
from palpate.common.user_effects import rehearse, watched
from palpate.study import Study
from robot_io.errors import InputError
from tests.estimation.presses import session
from tests.palpate.presses import write_presses

DATA = session(1)


class Power(AdditiveEffect):
    """Sound up to a depth, and then as `goes_wrong` has it."""

    name = "power"
    physics = equation = source = signature = "none"
    channels = frozenset(ChannelKind)
    gains = (Parameter("k", "N", -1e6, 1e6, (0.1, 10.0)),)
    inner = (Parameter("d", "m", 0.0, 0.2, (0.001, 0.02)),)
    goes_wrong = staticmethod(lambda data, columns: columns)

    def columns(self, data, inner):
        made = np.maximum(data.position - inner["d"], 0.0)[:, None] ** 2
        return type(self).goes_wrong(data, made) if inner["d"] > 0.015 else made


def write(data, columns):
    data.effort[:] = 0.0
    return columns


def stop(data, columns):
    raise ZeroDivisionError("by nothing")


WRONG = {
    "read-only": write,
    "by nothing": stop,
    "not finite": lambda data, columns: columns * np.nan,
    "shape": lambda data, columns: columns[:, 0],
    "type complex": lambda data, columns: columns * 1j,
}


@pytest.mark.parametrize("words", WRONG)
def test_what_a_rehearsal_does_not_come_to_is_one_clear_line_all_the_same(words):
    found = type("Wrong", (Power,), {"goes_wrong": staticmethod(WRONG[words])})
    effect, before = watched(found()), DATA.effort.copy()
    rehearse(effect, DATA)
    with pytest.raises(InputError, match=f"effect 'power' on channel 'contact'.*{words}"):
        effect.columns(DATA, {"d": 0.018})
    assert np.array_equal(DATA.effort, before)


OWN = """\
import numpy as np

from estimation.channel import ChannelKind
from estimation.effect import AdditiveEffect, Parameter


class Mine(AdditiveEffect):
    name = "mine"
    physics = equation = source = signature = "none"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k", "N", -1e6, 1e6, (0.1, 10.0)),)

    def columns(self, data, inner):
        depth = np.maximum(data.position, 0.0)
        return depth[:, None]
"""


@pytest.mark.parametrize(
    ("sound", "wrong", "line", "words"),
    [
        ("return depth[:, None]", "return np.linalg.inv(depth[:, None])", 16, "square"),  # raised in numpy
        ("return depth[:, None]", "return depth", 14, "shape"),
        ("return depth[:, None]", "return 0.0 * depth[:, None]", 14, "zero throughout"),
        ("return depth[:, None]", "return np.random.rand(len(depth), 1)", 14, "other values"),
        ('name = "mine"', 'name = "My name"', 8, "its name is"),
        ("(0.1, 10.0)", "(10.0, 0.1)", 12, "ascending order"),
        ("frozenset({ChannelKind.CONTACT})", '{"contact"}', 11, "ChannelKind.REVOLUTE"),
        (
            '    signals = ("position",)\n',
            '    signals = ("position",)\n    needs = 3\n',
            11,
            "its needs are",
        ),
        ('"mine"\n    physics = ', '"mine"\n    ', 7, "states no physics"),
        ("data.position", "data.depth", 15, "depth"),
    ],
)
def test_the_error_of_an_own_effect_names_the_user_s_line(tmp_path, sound, wrong, line, words):
    assert sound in OWN
    (tmp_path / "mine.py").write_text(OWN.replace(sound, wrong))
    with pytest.raises(InputError, match=words) as error:
        Study(write_presses(tmp_path / "press.csv"), keep=False, effects=[f"{tmp_path}/mine.py:Mine"])
    assert f"(mine.py, line {line})" in str(error.value)


def test_a_sound_effect_gives_what_it_gave_before_and_keeps_its_module():
    effect = watched(Power())
    assert np.array_equal(effect.columns(DATA, {"d": 0.018}), Power().columns(DATA, {"d": 0.018}))
    assert type(effect).__module__ == Power.__module__
    assert isinstance(effect, Power)
