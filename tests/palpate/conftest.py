"""One real probing session that several tests read."""

import json

import pytest

from tests.palpate.cli import run


@pytest.fixture(scope="session")
def probed(tmp_path_factory):
    """A session file of the default object at three speeds, and what the command said about it."""
    path = tmp_path_factory.mktemp("probed") / "default.mcap"
    result = run("probe", "--out", path, "--seed", 5, "--hold-s", 0.3, "--json")
    assert result.exit_code == 0, result.stderr
    return path, json.loads(result.stdout)
