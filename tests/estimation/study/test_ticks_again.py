import pytest

from palpate.estimation.study.sessions import read_session, with_ticks, without_ticks
from palpate.robot_io.errors import InputError
from tests.palpate.sessions import synthetic_session


def test_ticks_are_read_again_from_the_same_session_only(tmp_path):
    path = tmp_path / "press.mcap"
    synthetic_session(path)
    light = without_ticks(read_session(path, ())[0])
    assert "run" not in light.samples("tick")
    assert "run" in with_ticks(light).samples("tick")
    path.unlink()
    synthetic_session(path, seed=8)
    with pytest.raises(InputError, match="another session"):
        with_ticks(light)
