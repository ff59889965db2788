"""Whoever is killed, with a real SIGKILL: no finished case is repeated, and all are finished in the end."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter

import psutil
import pytest

from palpate.sweep import ResultStore
from tests.free_port import free_port
from tests.palpate.cli import ROOT
from tests.palpate.sweep.client import cases

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0


def start(*command):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, *map(str, command)],
        cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def client(folder, *scheduler):
    return start("-m", "tests.palpate.sweep.client", folder, *scheduler)


def starts(folder):
    """Seed and process of every start of a case, in order."""
    path = folder / "starts"
    return [tuple(map(int, line.split())) for line in path.read_text().splitlines()] if path.exists() else []


def landed(folder):
    return len(ResultStore(folder / "results").finished())


def wait_for(true, what):
    until_s = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < until_s, what
        time.sleep(0.02)


def check_all_done_and_only_running_repeated(folder, finished_at_kill, most_repeated):
    assert landed(folder) == 12
    count = Counter(seed for seed, _ in starts(folder))
    repeated = [seed for seed, times in count.items() if times > 1]
    assert sorted(count) == list(range(12))
    assert len(repeated) <= most_repeated
    seeds = {case.address: case.seed for case in cases(folder)}
    assert not {seeds[address] for address in finished_at_kill} & set(repeated)
    rows = ResultStore(folder / "results").rows(seeds)
    assert [row["square"] for row in rows] == [seed**2 for seed in range(12) for _ in range(2)]


def test_killed_client_ends_its_workers_and_a_new_client_continues(tmp_path):
    first = client(tmp_path)
    wait_for(lambda: landed(tmp_path) >= 3, "no case landed")
    first.kill()
    first.communicate()
    workers = {process for _, process in starts(tmp_path)}
    wait_for(lambda: not any(map(psutil.pid_exists, workers)), "workers outlive their client")
    finished = ResultStore(tmp_path / "results").finished()
    out, _ = client(tmp_path).communicate(timeout=PATIENCE_S)
    assert int(out) == 12 - len(finished)
    check_all_done_and_only_running_repeated(tmp_path, finished, most_repeated=2)


def test_killed_worker_loses_only_its_running_case(tmp_path):
    running = client(tmp_path)
    wait_for(lambda: landed(tmp_path) >= 3, "no case landed")
    finished = ResultStore(tmp_path / "results").finished()
    os.kill(starts(tmp_path)[-1][1], signal.SIGKILL)
    out, errors = running.communicate(timeout=PATIENCE_S)
    assert out.strip() == "12", errors
    check_all_done_and_only_running_repeated(tmp_path, finished, most_repeated=1)


def test_other_users_cannot_reach_the_workers(tmp_path):
    """Whoever reached a port of theirs could have them run anything."""
    running = client(tmp_path)
    wait_for(lambda: len(starts(tmp_path)) >= 2, "no case started")
    tree = psutil.Process(running.pid)
    open_sockets = [
        one for each in (tree, *tree.children(recursive=True)) for one in each.net_connections("inet")
    ]
    running.kill()
    running.communicate()
    assert not open_sockets


def test_killed_scheduler_ends_the_client_and_a_new_one_continues(tmp_path, dask_on):
    scheduler, address = dask_on()
    running = client(tmp_path, address)
    wait_for(lambda: landed(tmp_path) >= 3, "no case landed")
    scheduler.kill()
    _, errors = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 1
    assert "run the same command again to continue" in errors.splitlines()[-1]
    time.sleep(1.0)  # what was running lands, though nobody asks any more
    finished = ResultStore(tmp_path / "results").finished()
    _, address = dask_on()
    out, errors = client(tmp_path, address).communicate(timeout=PATIENCE_S)
    assert out.strip() == str(12 - len(finished)), errors
    check_all_done_and_only_running_repeated(tmp_path, finished, most_repeated=2)


@pytest.fixture
def dask_on():
    """Starts a scheduler with two workers of its own, as on other machines; gives it, and its address."""
    processes = []

    def begin():
        port = free_port()
        address = f"tcp://127.0.0.1:{port}"
        scheduler = start("-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        one = ("--nthreads", 1, "--death-timeout", 5, "--no-dashboard")
        workers = [start("-m", "dask", "worker", address, *one) for _ in range(2)]
        processes.extend([scheduler, *workers])
        return scheduler, address

    yield begin
    for process in processes:
        process.kill()
        process.communicate()
