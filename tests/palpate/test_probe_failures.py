"""`palpate probe` when the torque stays on or nothing is stored."""

import json
import resource
import sys

import pytest

from palpate.commands import probe as command
from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.errors import DeviceError, SafetyTripError
from palpate.robot_io.session import Session, SessionWriter
from palpate.runs import session as run_session
from palpate.runs.probing import ProbingJob, ProbingOutcome, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.drivers import SimTorque
from tests.log_in_process import LogInProcess
from tests.palpate.cli import run
from tests.palpate.sessions import QUICK, QUICK_RUN


@pytest.fixture
def refusals(log_in_process, monkeypatch):
    """What happened to drives and log; the drives refuse to be switched off as often as the list says."""
    happened, left = [], []
    deactivate, close = SimTorque.deactivate, LogInProcess.close

    def refuse(self):
        happened.append("torque off")
        if left and left.pop():
            raise DeviceError("the drives do not answer")
        deactivate(self)

    def note_close(self):
        happened.append("log closed")
        close(self)

    monkeypatch.setattr(SimTorque, "deactivate", refuse)
    monkeypatch.setattr(LogInProcess, "close", note_close)
    return happened, left


def probe(tmp_path):
    return run_probing(ProbingJob(find_robot("follower"), tmp_path / "x.mcap", QUICK_RUN, online=None))


def test_next_attempt_does_not_wait_for_the_log(tmp_path, refusals):
    happened, left = refusals
    left.append(True)
    outcome = probe(tmp_path)
    assert happened.index("log closed") >= 2
    assert happened[:2] == ["torque off", "torque off"]
    assert outcome.loop.outcome is Outcome.TRIPPED
    assert "the drives do not answer" in outcome.loop.cause
    assert outcome.loop.deactivation_error == ""  # by now it is off


def test_user_is_asked_to_cut_the_power_if_torque_stays_on(tmp_path, refusals):
    _, left = refusals
    left += [True] * 20
    outcome = probe(tmp_path)
    assert "the drives do not answer" in outcome.loop.deactivation_error
    with pytest.raises(SafetyTripError, match=r"the torque may still be on; cut the power: .* do not answer"):
        outcome.raise_for_failure()


def test_unreleased_device_does_not_hide_the_stop_cause(tmp_path, log_in_process, monkeypatch):
    close = SimTorque.close

    def fail(self):
        close(self)
        raise DeviceError("the port does not close")

    monkeypatch.setattr(SimTorque, "close", fail)
    monkeypatch.setattr(ProbingTask, "step", lambda *_: 1 / 0)
    with pytest.raises(
        DeviceError,
        match=r"ZeroDivisionError.*; then the arm's devices failed to close: .*the port does not close",
    ):
        probe(tmp_path)


TROUBLES = {
    "unsent": (3, "3 commands not sent"),
    "log_error": ("disk full", "the log is not complete: disk full"),
    "observer_error": ("singular", "online estimation was switched off: singular"),
    "deactivation_error": ("no answer", "the torque may still be on: no answer"),
}


@pytest.fixture
def ended(monkeypatch, tmp_path):
    """`palpate probe` whose run ended as a result says."""

    def probe_ends(result, *options):
        outcome = ProbingOutcome(tmp_path / "x.mcap", result, ())
        monkeypatch.setattr(command, "run_probing", lambda _job, _watcher: outcome)
        return run("probe", "-o", tmp_path / "x.mcap", *options)

    return probe_ends


@pytest.mark.parametrize("name", TROUBLES)
@pytest.mark.parametrize("outcome", list(Outcome))
def test_every_logged_problem_is_shown(ended, name, outcome):
    value, words = TROUBLES[name]
    result = LoopResult(outcome, cause="" if outcome is Outcome.FINISHED else "asked", **{name: value})
    assert words in " ".join(ended(result).stdout.split())
    assert json.loads(ended(result, "--json").stdout)[name] == value


def test_clean_run_gives_no_warning(ended):
    said = ended(LoopResult(Outcome.FINISHED, ticks=7))
    assert said.exit_code == 0
    assert "ticks" not in said.stdout


def test_estimation_without_contact_is_refused(ended, monkeypatch, tmp_path):
    stopped = LoopResult(Outcome.STOPPED, cause="interrupted by the user (SIGINT)", ticks=9)
    assert "palpate estimate" in ended(stopped).stderr
    outcome = ProbingOutcome(tmp_path / "x.mcap", stopped, (), touched=False)
    monkeypatch.setattr(command, "run_probing", lambda _job, _watcher: outcome)
    said = run("probe", "-o", tmp_path / "x.mcap").stderr
    assert "palpate estimate" not in said
    assert "palpate inspect" in said


def test_possible_torque_outweighs_the_user_s_ctrl_c(ended):
    result = LoopResult(Outcome.STOPPED, cause="interrupted by the user (SIGINT)")
    assert ended(result).exit_code == 130
    said = ended(LoopResult(Outcome.STOPPED, cause="interrupted", deactivation_error="joint 2 is silent"))
    assert said.exit_code == 1
    assert "cut the power: joint 2 is silent" in said.stderr


ROOM_BYTES = 300_000  # to the writer process a file that may not grow is a disk that is full


class SmallDisk(SessionWriter):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (ROOM_BYTES, ROOM_BYTES))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits another process as Linux does")
def test_full_disk_stops_no_arm_and_is_one_line(tmp_path, monkeypatch):
    path = tmp_path / "s.mcap"
    monkeypatch.setattr(run_session, "SessionWriter", SmallDisk)
    said = run("probe", "-o", path, "--experiment", QUICK, "--online", "none")
    assert said.exit_code == 3
    assert said.stderr.strip().endswith("s.mcap is not complete: File too large")
    session = Session.open(path)
    assert session.truncated
    ticks = session.samples("tick")
    assert len(ticks) > 300
    assert (ticks["phase"] > 0).any()
