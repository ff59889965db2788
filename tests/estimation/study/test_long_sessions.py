"""Long sessions: ticks leave the memory after shortening and are read again when needed."""

import numpy as np
import pytest

from palpate.estimation.fit import long_data
from palpate.estimation.study.sessions import read_session, with_ticks, without_ticks
from palpate.estimation.study.source import limit_length, open_source
from palpate.robot_io.errors import InputError
from tests.palpate.sessions import synthetic_session


def test_ticks_of_a_long_session_are_read_again_for_an_estimate(tmp_path, monkeypatch):
    source = open_source(synthetic_session(tmp_path / "s.mcap"))
    assert "lateness_s" not in source.session.samples("tick")  # nothing is computed from it
    assert limit_length(source).session is source.session  # it is short
    monkeypatch.setattr(long_data, "LONG", 1000)
    limited = limit_length(source)
    assert limited.averaged
    assert list(limited.session.samples("tick")) == ["joint_position_rad"]
    expected, read = source.tared({"contact"}), limited.tared({"contact"})
    assert len(read) == 1
    assert read[0].tare is not None
    np.testing.assert_array_equal(read[0].effort, expected[0].effort)


def test_ticks_are_read_again_from_the_same_session_only(tmp_path):
    path = tmp_path / "press.mcap"
    synthetic_session(path)
    light = without_ticks(read_session(path, ())[0])
    assert "run" not in light.samples("tick")
    assert "run" in with_ticks(light).samples("tick")
    path.unlink()
    synthetic_session(path, seed=8)
    with pytest.raises(InputError, match="a different session"):
        with_ticks(light)
