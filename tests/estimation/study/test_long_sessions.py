"""A long session: its ticks leave the memory once its channels are shortened, and come back when needed."""

import numpy as np

from palpate.estimation.fit import long_data
from palpate.estimation.study.source import limit_length, open_source
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
