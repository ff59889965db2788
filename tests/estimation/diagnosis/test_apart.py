"""Several channels at the same time."""

import pickle
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import Pipe

import numpy as np
import pytest
from estimation.diagnosis.apart import Job, diagnose_apart
from estimation.diagnosis.helping import Shared, lend_a_hand, shared

from estimation.base_model import ModelContext
from estimation.diagnosis import apart
from estimation.effects import EFFECTS
from estimation.effects.bias import Bias
from estimation.models import MODELS
from robot_io.errors import PalpateError
from tests.estimation.presses import kelvin_voigt, maxwell, session

FEW = tuple(EFFECTS[name]() for name in ("cubic_stiffness", "bias"))


def relaxing(time_s, x, v, run):
    return kelvin_voigt(x, v, 600.0 * maxwell(time_s, x, run, 0.1))


@pytest.fixture
def jobs():
    model = MODELS["kelvin_voigt"]().build(ModelContext())
    laws = {1: {"law": relaxing}}  # which neither of the few effects explains, nor both: all pairs are tried
    known = [replace(session(seed, **laws.get(seed, {})), name=f"contact_{seed}") for seed in (1, 2, 3)]
    return [Job(data, model, FEW, seed=4) for data in known]


def test_the_answers_are_those_of_one_after_the_other(jobs, monkeypatch):
    told = []
    alone = diagnose_apart(jobs, 1, lambda what, share: None)
    monkeypatch.setattr(apart, "_FEWEST_SAMPLES", 0)
    together = diagnose_apart(jobs, 2, lambda what, share: told.append(what))
    assert [one.found.model_dump() for one in together] == [one.found.model_dump() for one in alone]
    assert {f"contact_{seed}: done" for seed in (1, 2, 3)} <= set(told)


def test_a_user_s_effect_is_tried_in_the_process_that_knows_it(jobs, monkeypatch):
    class Own(Bias):
        name = "own"

    monkeypatch.setattr(apart, "_FEWEST_SAMPLES", 0)
    monkeypatch.setattr(apart, "_workers", None)
    own = [replace(job, effects=(*FEW, Own())) for job in jobs]
    ranked = {entry.effect for entry in diagnose_apart(own, 2, lambda what, share: None)[0].found.ranking}
    assert "own" in ranked


def test_a_channel_arrives_whole_in_another_process(jobs):
    data = replace(jobs[0].data, context={"load": np.arange(len(jobs[0].data), dtype=float)})
    arrived = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(arrived.effort, data.effort)
    np.testing.assert_array_equal(arrived.context["load"], data.context["load"])
    assert (arrived.name, arrived.kind) == (data.name, data.kind)


def test_a_process_that_ended_is_said_to_have_ended(jobs):
    ours, theirs = Pipe()
    theirs.close()
    with pytest.raises(PalpateError, match="was ended"):
        apart._share_out(jobs, [ours], lambda what, share: None)


@dataclass(frozen=True)
class Asking:
    """A job that does nothing but ask for help with tasks, of which one fails."""

    failing: int

    def run(self, progress, each):
        return each(partial(fail_at, self.failing), range(4), lambda number: None)


def fail_at(failing, number):
    if number == failing:
        raise ZeroDivisionError(f"task {number}")
    return number


def work(pipe):
    """As a process: its pipe is closed when it ends."""
    with pipe:
        apart._work(pipe)


@pytest.mark.parametrize("failing", [0, 1], ids=["who asked", "the helper"])
def test_a_task_that_fails_is_told_with_its_reason(failing, monkeypatch):
    """Two threads stand for the processes: who asks gets the first task, who helps the second."""
    monkeypatch.setattr(apart.signal, "signal", lambda *_: None)  # only a main thread may set it
    pipes = [Pipe(), Pipe()]
    with ThreadPoolExecutor(2) as threads, ExitStack() as ended:
        workers = [ended.enter_context(ours) for ours, _ in pipes]
        at_work = [threads.submit(work, theirs) for _, theirs in pipes]
        with pytest.raises(ZeroDivisionError, match=f"task {failing}"):
            apart._share_out([Asking(failing)], workers, lambda what, share: None)
    assert all(isinstance(one.exception(), EOFError | OSError) for one in at_work)


def double(number):
    return 2 * number


def test_help_is_given_to_whoever_asks_by_all_who_are_free():
    """Three threads with pipes stand for the asker, a helper, and the process between them."""
    asker, asker_side = Pipe()
    helper, helper_side = Pipe()
    begun = []
    with ThreadPoolExecutor(2) as threads:
        results = threads.submit(shared, asker_side, double, range(5), begun.append)
        one = Shared(asker, asker.recv(), deque(range(5)))
        one.give(asker)
        threads.submit(lend_a_hand, helper_side, one.help)
        one.helpers = 1
        one.give(helper)
        goes_on = {asker: True, helper: True}
        while any(goes_on.values()):
            for worker in [w for w in (helper, asker) if goes_on[w] and w.poll(0.01)]:
                goes_on[worker] = one.take(worker, worker.recv())
        assert results.result() == [0, 2, 4, 6, 8]
    assert sorted([*begun, *one.found]) == [0, 1, 2, 3, 4]
    assert one.found, "the helper did nothing"
