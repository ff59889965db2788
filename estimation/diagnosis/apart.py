"""Diagnoses several channels at the same time, in processes of their own."""

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

import numpy as np

from estimation.channel import ChannelData
from estimation.diagnosis.diagnose import diagnose
from estimation.diagnosis.each import Each, one_by_one
from estimation.diagnosis.helping import Done, Help, Shared, lend_a_hand, shared
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.result import ChannelDiagnosis
from estimation.diagnosis.robot import judge_robot
from estimation.effect import Effect
from estimation.model import Model
from robot_io.errors import PalpateError

Progress = Callable[[str, float], None]  # what is being done, and the share of it that is done
_FEWEST_SAMPLES = 60_000  # in all channels; with fewer, starting processes takes longer than it saves


@dataclass(frozen=True)
class Job:
    """One channel to diagnose.

    Attributes:
        data: the channel.
        model: its base model.
        effects: the library.
        seed: of the surrogates.
    """

    data: ChannelData
    model: Model
    effects: tuple[Effect, ...]
    seed: int

    def run(self, progress: Progress, each: Each = one_by_one) -> ChannelDiagnosis:
        """Do it."""
        rng = np.random.default_rng(self.seed)
        told = diagnose(self.data, self.model, self.effects, rng=rng, progress=progress, each=each)
        found = told.channels[0]
        progress(f"{self.data.name}: done", 1.0)
        return found


def diagnose_apart(jobs: Sequence[Job], processes: int, progress: Progress) -> list[Judged]:
    """Diagnose channels, several at a time where that is worth it; the answers are the same either way.

    Effects that were loaded from a file of the user's are not known to another process, so with such the
    channels are done one after the other. New processes import the program's main module: a script that asks
    for more than one needs the usual `if __name__ == "__main__":`.

    Args:
        jobs: one for each channel.
        processes: how many may be at work at the same time.
        progress: told what is being done; reports of several channels alternate.

    Raises:
        PalpateError: a process ended before it had an answer, for instance for want of memory.
    """
    count = min(processes, len(jobs))
    if count < 2 or sum(len(job.data) for job in jobs) < _FEWEST_SAMPLES or not _importable(jobs):
        return _judge(jobs, lambda some: [job.run(progress) for job in some])
    with _workers(count) as workers:
        return _judge(jobs, lambda some: _share_out(some, workers, progress))


def _judge(jobs: Sequence[Job], run: Callable[[Sequence[Job]], list[ChannelDiagnosis]]) -> list[Judged]:
    channels, models = [job.data for job in jobs], [job.model for job in jobs]

    def run_some(
        numbers: Sequence[int], made: Sequence[ChannelData], bases: Sequence[Model]
    ) -> list[ChannelDiagnosis]:
        asked = zip(numbers, made, bases, strict=True)
        return run([replace(jobs[i], data=data, model=base) for i, data, base in asked])

    return judge_robot(channels, models, jobs[0].effects if jobs else (), run_some)


def _importable(jobs: Sequence[Job]) -> bool:
    effects = [effect for job in jobs for effect in (*job.effects, *job.model.effects)]
    return all(type(effect).__module__.startswith("estimation.") for effect in effects)


def _share_out(
    jobs: Sequence[Job], workers: Sequence[Connection], progress: Progress
) -> list[ChannelDiagnosis]:
    """The next job to whoever is free; where there is none, help for those who asked for it."""
    waiting = list(enumerate(jobs))
    found: dict[int, ChannelDiagnosis] = {}
    at_work: dict[Connection, int] = {}
    asked: dict[Connection, Shared] = {}
    helping: dict[Connection, Shared] = {}

    def give_next(worker: Connection) -> None:
        wanted = next((one for one in asked.values() if one.waiting), None)
        if waiting:
            at_work[worker], job = waiting.pop(0)
            worker.send(job)
        elif wanted:
            helping[worker] = wanted
            wanted.join(worker)

    def take(worker: Connection, answer: ChannelDiagnosis | Help | Done) -> None:
        if isinstance(answer, ChannelDiagnosis):
            found[at_work.pop(worker)] = answer
            give_next(worker)
        elif isinstance(answer, Help):
            asked[worker] = Shared(worker, answer, deque(range(len(answer.tasks))))
            asked[worker].give(worker)
            for idle in [one for one in workers if one not in at_work and one not in helping]:
                give_next(idle)
        elif worker not in helping:
            asked[worker].take(worker, answer)
        elif not helping[worker].take(worker, answer):
            del helping[worker]
            give_next(worker)

    with _noticed():
        for worker in workers:
            give_next(worker)
    while at_work:
        for ready in wait([*at_work, *helping]):
            worker = next(w for w in workers if w is ready)
            answer = _answer(worker)
            if isinstance(answer, tuple):
                progress(*answer)
                continue
            with _noticed():
                take(worker, answer)
    return [found[number] for number in range(len(jobs))]


def _answer(worker: Connection) -> ChannelDiagnosis | Help | Done | tuple[str, float]:
    with _noticed():
        answer = worker.recv()
    if isinstance(answer, Exception):
        raise answer
    found: ChannelDiagnosis | Help | Done | tuple[str, float] = answer
    return found


@contextmanager
def _noticed() -> Iterator[None]:
    """Says so if the process at the other end is no more."""
    try:
        yield
    except (EOFError, OSError) as error:
        raise PalpateError("a process that diagnosed a channel was ended; is there enough memory?") from error


@contextmanager
def _workers(count: int) -> Iterator[list[Connection]]:
    """Processes that wait for jobs, by their pipes; they end with the context, whatever they are doing."""
    spawn = multiprocessing.get_context("spawn")
    processes: list[SpawnProcess] = []
    pipes: list[Connection] = []
    try:
        for _ in range(count):
            ours, theirs = spawn.Pipe()
            pipes.append(ours)
            processes.append(spawn.Process(target=_work, args=(theirs,), daemon=True))
            processes[-1].start()
            theirs.close()
        yield pipes
    finally:
        for process in processes:
            process.terminate()
            process.join()
        for pipe in pipes:
            pipe.close()


def _work(parent: Connection) -> None:
    """Do jobs until ended by the parent, whose business Ctrl-C is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        asked: Job | Help = parent.recv()
        try:
            if isinstance(asked, Help):
                lend_a_hand(parent, asked)
                continue
            answer: ChannelDiagnosis | Exception = asked.run(
                lambda what, share: parent.send((what, share)), partial(shared, parent)
            )
        except Exception as error:
            answer = error
        parent.send(answer)
