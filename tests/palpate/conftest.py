"""One real probing session that several tests read, and a diagnosis that does not try everything."""

import json

import pytest

from palpate.robot_io.errors import describe_error
from palpate.runs import session
from palpate.sweep import runner
from tests.built_once import built_once
from tests.few_effects import shorten_budget, try_few_effects
from tests.log_in_process import LogInProcess
from tests.palpate.cli import done
from tests.palpate.computed_once import compute_once
from tests.palpate.presses import write_presses


@pytest.fixture(scope="module", autouse=True)
def short_analyses():
    """What the commands print has a budget that few combinations were tried for; equal work is done once."""
    with pytest.MonkeyPatch.context() as patch:
        shorten_budget(patch)
        compute_once(patch)
        yield


@pytest.fixture(scope="session")
def probed(tmp_path_factory):
    """A session file of the default object at three speeds, and what the command said about it."""

    def probe(folder):
        result = done("probe", "--out", folder / "default.mcap", "--seed", 5, "--hold-s", 0.3, "--json")
        (folder / "said.json").write_text(result.stdout)

    folder = built_once(tmp_path_factory, "probed", probe)
    return folder / "default.mcap", json.loads((folder / "said.json").read_text())


@pytest.fixture(scope="session")
def hardening(tmp_path_factory):
    """A data file of presses onto a spring that stiffens; nobody may write beside it."""
    return write_presses(tmp_path_factory.mktemp("hardening") / "hardening.csv")


@pytest.fixture
def log_in_process(monkeypatch):
    """Sessions are written without a process for each."""
    monkeypatch.setattr(session, "SessionWriter", LogInProcess)


@pytest.fixture
def few_effects(monkeypatch):
    """A diagnosis tries few effects."""
    try_few_effects(monkeypatch)


def run_here(todo, folder, workers):
    """Work on cases in this process."""
    for address, case in todo.items():
        try:
            runner.run_one(case, address, folder)
            yield ""
        except Exception as error:  # as a worker tells it
            yield f"{case.label}: {describe_error(error)}"


@pytest.fixture(scope="module")
def one_process():
    """Batches and sweeps of a module work in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "run_in_processes", run_here)
        yield


@pytest.fixture
def without_figures(monkeypatch):
    """Reports have no figures, which take a third of the time of `palpate add`; test_report.py has them."""
    from palpate.render import report

    for name in ("error_steps_figure", "map_figure", "time_figure", "state_figure"):
        monkeypatch.setattr(report, name, lambda _channel: None)
    monkeypatch.setattr(report, "as_html", lambda _figure: report.Markup())
