import errno
import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.robot_io.errors import InputError, SessionError, UnknownNameError
from palpate.robot_io.files.atomic_write import atomic_write
from palpate.robot_io.session import Column, Event, Session, SessionWriter, Stream, write_session, writer
from palpate.robot_io.session.event import decode_event, encode_event
from palpate.robot_io.session.mcap_file import McapFile
from palpate.robot_io.session.shared_log import (
    FAILED,
    READY,
    STARTING,
    SharedLog,
    is_locked,
    lock,
    open_memory,
)
from tests.robot_io.session_parts import METADATA, TICK, assert_ticks, tick, ticks

SLOW = Stream("slow", (Column("time_s", "s"), Column("x", "m")))
ROOT = Path(__file__).resolve().parents[2]

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="looks into Linux's /proc or sets its limits")


def wait_until(condition, limit_s=30.0):
    give_up_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < give_up_s, "it did not happen"
        time.sleep(0.02)


def samples_on_disk(path, stream="tick"):
    """Samples that can be read while the file is being written; none before its header is there."""
    try:
        return len(Session.open(path).samples(stream))
    except SessionError:
        return 0


def append(log, numbers):
    for record in ticks(numbers):
        log.append("tick", record)


def pid(log):
    return log._process.pid


def stop(log):
    os.kill(pid(log), signal.SIGSTOP)
    os.waitpid(pid(log), os.WUNTRACED)  # the signal is asynchronous; wait until it has stopped


@linux_only
def test_hanging_disk_holds_no_program_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "STALL_LIMIT_S", 1.5)
    monkeypatch.setattr(writer, "_KILL_LIMIT_S", 0.2)
    log = SessionWriter(tmp_path / "s.mcap", [TICK], METADATA, ring_slots=4, wait_for_room=True)
    stop(log)
    append(log, range(4))
    with pytest.raises(SessionError, match="the disk accepted no data"):
        log.append("tick", tick(4))
    log.append("tick", tick(5))
    assert log.dropped == 1
    begun_s = time.monotonic()
    with pytest.raises(SessionError, match="the end is missing"):
        log.close()
    assert time.monotonic() - begun_s < 1.5  # once is enough


@pytest.mark.parametrize("meanwhile", [Path.unlink, lambda path: (path.unlink(), path.write_bytes(b""))])
def test_file_deleted_during_writing_is_reported(meanwhile, tmp_path):
    log = SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)
    log.append("tick", tick(0))
    meanwhile(tmp_path / "s.mcap")
    with pytest.raises(SessionError, match="deleted or replaced while it was being written"):
        log.close()


def test_logged_data_are_read_back(tmp_path):
    path = tmp_path / "new" / "s.mcap"
    with SessionWriter(path, [TICK, replace(SLOW, batch=50)], METADATA) as log:
        append(log, range(3000))
        log.append("slow", np.array((2.5, -1.0), SLOW.dtype)[()])
        for number in range(130):
            log.append("slow", (3.0 + number, float(number)))
        data = {"force_n": np.float64(31.0), "joints": np.arange(2), 3: Path("x")}
        log.event(1.25, "trip", "force over 30 N", data)
        log.event(-1.0, "mark", "")

    session = Session.open(path)
    assert session.metadata == METADATA
    assert session.stream_names == ("tick", "slow")
    assert_ticks(session.samples("tick"), range(3000))
    assert session.samples("slow")["x"].tolist() == list(range(-1, 130))
    trip, mark = session.events
    assert (trip.time_s, trip.kind, trip.text) == (1.25, "trip", "force over 30 N")
    assert trip.data == {"force_n": 31.0, "joints": [0, 1], "3": "x"}
    assert (mark.time_s, mark.kind, mark.text, mark.data) == (-1.0, "mark", "", None)
    assert not session.truncated
    assert session.dropped == log.dropped == 0
    assert log.failure is None


def test_stopped_writer_never_blocks_the_loop_and_drops_are_seen(tmp_path):
    path = tmp_path / "s.mcap"
    log = SessionWriter(path, [TICK], METADATA, ring_slots=100)
    log.append("tick", tick(0))
    wait_until(lambda: log._log.rings["tick"].taken == 1)
    stop(log)
    append(log, range(1, 500))
    for _ in range(600):
        log.event(0.0, "mark", "one of too many")
    assert log.dropped == 399 + 600 - 512
    os.kill(pid(log), signal.SIGCONT)
    wait_until(lambda: not log._log.rings["tick"].full)
    log.append("tick", tick(500))
    log.close()

    session = Session.open(path)
    assert session.dropped == log.dropped
    assert_ticks(session.samples("tick"), [*range(101), 500])


def test_final_drops_are_counted_too(tmp_path):
    path = tmp_path / "s.mcap"
    log = SessionWriter(path, [TICK], METADATA, ring_slots=10)
    stop(log)
    append(log, range(25))
    os.kill(pid(log), signal.SIGCONT)
    log.close()
    session = Session.open(path)
    assert session.dropped == 15
    assert_ticks(session.samples("tick"), range(10))


def test_whole_ring_reaches_the_file_at_the_end(tmp_path):
    log = SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)
    stop(log)
    append(log, range(3000))  # more than the writer takes at once
    log._log.request_stop()
    os.kill(pid(log), signal.SIGCONT)
    log.close()
    assert_ticks(Session.open(tmp_path / "s.mcap").samples("tick"), range(3000))


def test_simulated_time_waits_instead_of_dropping(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", [TICK], METADATA, ring_slots=1, wait_for_room=True) as log:
        append(log, range(20))
    session = Session.open(tmp_path / "s.mcap")
    assert session.dropped == 0
    assert_ticks(session.samples("tick"), range(20))


def test_slow_stream_is_written_during_the_session(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", [SLOW], METADATA) as log:
        for number in range(3):
            log.append("slow", (float(number), 0.0))
        wait_until(lambda: samples_on_disk(tmp_path / "s.mcap", "slow") == 3)
        assert Session.open(tmp_path / "s.mcap").truncated


def test_killed_writer_leaves_all_but_the_last_chunk(tmp_path):
    path, count = tmp_path / "s.mcap", 8_000
    log = SessionWriter(path, [TICK], METADATA, wait_for_room=True)
    append(log, range(count))
    wait_until(lambda: samples_on_disk(path) >= 0.99 * count)
    os.kill(pid(log), signal.SIGKILL)
    wait_until(lambda: log.failure is not None)
    log.append("tick", tick(count))  # the loop goes on
    with pytest.raises(SessionError, match="-9"):
        log.close()

    session = Session.open(path)
    assert session.truncated
    samples = session.samples("tick")
    assert len(samples) >= 0.99 * count
    assert_ticks(samples, range(len(samples)))


PROGRAM = """
import os, signal, sys
from palpate.robot_io.session import SessionWriter
from tests.robot_io.session_parts import METADATA, TICK, ticks

log = SessionWriter(sys.argv[1], [TICK], METADATA)
for record in ticks(range(5000)):
    log.append("tick", record)
if sys.argv[2] == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[2] == "close":
    log.close()
"""


@linux_only
@pytest.mark.parametrize(("end", "code"), [("close", 0), ("kill", -signal.SIGKILL), ("forget", 0)])
def test_session_file_is_finished_for_any_program_end(tmp_path, end, code):
    path, before = tmp_path / "s.mcap", set(os.listdir("/dev/shm"))
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error"}
    command = [sys.executable, "-c", PROGRAM, str(path), end]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == "" or end == "forget"  # where Python warns of the writer that is still at work
    wait_until(lambda: samples_on_disk(path) and not Session.open(path).truncated)
    session = Session.open(path)
    assert_ticks(session.samples("tick"), range(5000))
    assert session.dropped == 0
    assert session.unclosed == (end != "close")
    assert [(event.kind, event.time_s) for event in session.events] == [("log", 4.999)] * session.unclosed
    left = set(os.listdir("/dev/shm")) - before
    assert not {name for name in left if "palpate" in name or name.startswith("psm_")}


def test_ctrl_c_and_termination_leave_the_writer_running(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", [TICK], METADATA) as log:
        for number in (0, 1):
            log.append("tick", tick(number))
            os.kill(pid(log), signal.SIGINT)
            os.kill(pid(log), signal.SIGTERM)
        # A terminal's Ctrl-C goes to its foreground process group, in which the writer is not.
        assert os.getpgid(pid(log)) != os.getpgid(0)
    assert_ticks(Session.open(tmp_path / "s.mcap").samples("tick"), range(2))


@linux_only
def test_full_disk_during_a_run_is_reported_at_the_end(tmp_path):
    path = tmp_path / "s.mcap"
    log = SessionWriter(path, [TICK], METADATA, ring_slots=1000)
    resource.prlimit(pid(log), resource.RLIMIT_FSIZE, (400_000, 400_000))
    number = 0
    give_up_s = time.monotonic() + 30
    while log.failure is None and time.monotonic() < give_up_s:
        log.append("tick", tick(number))
        number += 1
        time.sleep(1e-5)
    assert log.failure == "File too large"
    dropped = log.dropped
    for _ in range(2000):
        log.append("tick", tick(0))
    assert log.dropped >= dropped + 1000
    with pytest.raises(SessionError, match=r"s\.mcap is not complete: File too large"):
        log.close()

    session = Session.open(path)
    assert session.truncated
    samples = session.samples("tick")
    assert len(samples) > 500
    assert_ticks(samples.select(np.arange(100)), range(100))


@linux_only
def test_full_disk_is_reported_at_the_start(tmp_path):
    with pytest.raises(SessionError, match="already exists"):
        SessionWriter("/dev/full", [TICK], METADATA)
    (tmp_path / "file").touch()
    with pytest.raises(SessionError, match="cannot be written"):
        SessionWriter(tmp_path / "file" / "s.mcap", [TICK], METADATA)
    with pytest.raises(SessionError, match="File name too long"):
        SessionWriter(tmp_path / ("x" * 300), [TICK], METADATA)


@linux_only
def test_missing_memory_is_reported_before_writing(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(SessionError, match=r"the log needs .* MiB of memory .*File too large.*ulimit -f"):
            SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


def test_disk_that_hangs_at_the_end_does_not_hang_the_program(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "STALL_LIMIT_S", 0.2)
    log = SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)
    log.append("tick", tick(0))
    stop(log)
    with pytest.raises(SessionError, match="the disk accepted no data"):
        log.close()
    assert log._process.returncode == -signal.SIGKILL


def test_writer_that_does_not_start_does_not_hang_the_program(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "START_LIMIT_S", 0.0)
    with pytest.raises(SessionError, match="cannot be written: the writer process ended with -9"):
        SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)


def test_transferred_records_outlive_the_process(tmp_path):
    with (tmp_path / "s.mcap").open("wb") as file:
        mcap = McapFile(file, [SLOW], METADATA)
        assert os.stat(file.fileno()).st_size == file.tell() > 0
        mcap.finish({})
        assert os.stat(file.fileno()).st_size == file.tell()


def test_first_error_is_the_one_that_is_raised(tmp_path):
    def fail_in_session():
        with SessionWriter(tmp_path / "s", [TICK], METADATA) as log:
            log._process.kill()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        fail_in_session()
    assert "is not complete" in caught.value.__notes__[0]


def test_programming_mistakes_are_named(tmp_path):
    with pytest.raises(InputError, match="tick appears twice"):
        SessionWriter(tmp_path / "s", [TICK, TICK], METADATA)
    with pytest.raises(InputError, match="'events'"):
        SessionWriter(tmp_path / "s", [Stream("events", TICK.columns)], METADATA)
    with pytest.raises(InputError, match="ring_slots 0"):
        SessionWriter(tmp_path / "s", [TICK], METADATA, ring_slots=0)
    log = SessionWriter(tmp_path / "s", [TICK], METADATA)
    with pytest.raises(UnknownNameError, match=r"'tock'\. Valid: tick"):
        log.append("tock", tick(0))
    with pytest.raises((TypeError, ValueError)):
        log.append("tick", (1, 2))
    log.close()
    log.close()
    for late in (lambda: log.append("tick", tick(0)), lambda: log.event(0.0, "late", "")):
        with pytest.raises(InputError, match="is closed"):
            late()
    assert len(Session.open(tmp_path / "s").samples("tick")) == 0


def test_long_events_are_truncated_with_a_mark(tmp_path):
    with SessionWriter(tmp_path / "s", [SLOW], METADATA) as log:
        log.event(0.0, "k" * 100, "ü" * 5000, {"a": 1})
        log.event(0.0, "long", "short", {"a": "x" * 5000})
        log.event(0.0, "odd", "not \udcff text", {"nan": float("nan")})
    long, data, odd = Session.open(tmp_path / "s").events
    assert long.kind == "k" * 64
    assert long.text == "ü" * 1000 + " [cut]"
    assert (data.text, data.data) == ("short [cut]", None)
    assert odd.text == "not ? text"
    assert json.dumps(odd.data) == '{"nan": NaN}'


def test_both_sides_see_one_state_and_a_failure_as_far_as_it_fits():
    memory = open_memory([SLOW], 4)
    ours, theirs = (SharedLog(memory, [SLOW], 4) for _ in range(2))
    os.close(memory)
    assert (ours.state, theirs.stop_requested) == (STARTING, False)
    assert (ours.failure, ours.system_error) == (None, None)
    ours.request_stop()
    theirs.state = READY
    assert (ours.state, theirs.stop_requested, ours.failure) == (READY, True, None)
    theirs.fail("ü" * 1000, errno.ENOSPC)
    assert (ours.state, ours.failure, ours.system_error.errno) == (FAILED, "ü" * 480, errno.ENOSPC)
    theirs.fail("no reason", None)
    assert (ours.failure, ours.system_error) == ("no reason", None)
    for number in range(5):
        ours.rings["slow"].push((float(number), 0.0))
    assert theirs.rings["slow"].pop(9)[1]["time_s"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert (theirs.rings["slow"].dropped, theirs.rings["events"].offered) == (1, 0)


def test_event_that_just_fits_is_whole():
    sizes = {n: len(encode_event(Event(0.0, "k", "x" * n))) for n in range(3950, 4050)}
    assert max(sizes.values()) == 4000
    whole = [n for n in sizes if decode_event(encode_event(Event(0.0, "k", "x" * n))).text == "x" * n]
    assert whole == [n for n in sizes if sizes[n] > 3900]


@linux_only
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores to leave one")
def test_writer_leaves_the_core_and_the_priority_of_the_loop(tmp_path):
    everywhere = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(everywhere)})
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        with SessionWriter(tmp_path / "s", [SLOW], METADATA) as log:
            assert os.sched_getaffinity(pid(log)) == everywhere
            assert os.sched_getscheduler(pid(log)) == os.SCHED_OTHER
    finally:
        os.sched_setaffinity(0, everywhere)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def test_session_is_written_without_memfd(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "memfd_create", raising=False)
    with SessionWriter(tmp_path / "s", [TICK], METADATA) as log:
        log.append("tick", tick(0))
    assert_ticks(Session.open(tmp_path / "s").samples("tick"), [0])


RACE = """
import sys, time
from palpate.robot_io.session import SessionWriter
from tests.robot_io.session_parts import METADATA, TICK, tick
path, first = sys.argv[1], int(sys.argv[2])
print("ready", flush=True)
sys.stdin.readline()
with SessionWriter(path, [TICK], METADATA) as log:
    for number in range(first, first + 40):
        log.append("tick", tick(number))
        time.sleep(0.01)
"""


def test_only_one_program_can_create_a_session(tmp_path):
    path = tmp_path / "s.mcap"
    firsts = (0, 1000)
    begun = [
        subprocess.Popen(
            [sys.executable, "-c", RACE, str(path), str(first)],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for first in firsts
    ]  # fmt: skip
    assert [one.stdout.readline() for one in begun] == ["ready\n"] * 2
    for one in begun:
        one.stdin.write("go\n")
        one.stdin.flush()
    said = [one.communicate(timeout=60)[1].strip().splitlines()[-1:] for one in begun]
    (first,) = (first for first, words in zip(firsts, said, strict=True) if not words)
    assert_ticks(Session.open(path).samples("tick"), range(first, first + 40))
    assert not Session.open(path).truncated
    for words in said:
        late = ("is being written by another program at this moment", "already exists; a session is never")
        assert not words or any(reason in words[0] for reason in late)


def test_session_being_written_is_locked_until_its_program_ends(tmp_path):
    path = tmp_path / "s.mcap"
    with SessionWriter(path, [TICK], METADATA) as log:
        append(log, range(10))
        with pytest.raises(SessionError, match="is being written by another program at this moment"):
            SessionWriter(path, [TICK], METADATA)
        with pytest.raises(SessionError, match="is being written by another program at this moment"):
            write_session(path, [], METADATA)
    with pytest.raises(SessionError, match="already exists; a session is never changed"):
        SessionWriter(path, [TICK], METADATA)
    assert_ticks(Session.open(path).samples("tick"), range(10))
    os.kill(pid(SessionWriter(tmp_path / "killed.mcap", [TICK], METADATA)), signal.SIGKILL)
    wait_until(lambda: not is_locked(tmp_path / "killed.mcap"))


def test_lock_is_waited_for_while_a_program_checks_for_it(tmp_path):
    path = tmp_path / "s.mcap"
    path.touch()
    with path.open("rb") as checking, path.open("r+b") as writing:
        fcntl.flock(checking, fcntl.LOCK_SH)
        threading.Timer(0.1, fcntl.flock, (checking, fcntl.LOCK_UN)).start()
        lock(writing)
        assert is_locked(path)


def test_session_name_is_reserved_without_hard_links(tmp_path, monkeypatch):
    path, replace_file = tmp_path / "s.mcap", Path.replace

    def refuse(*_):
        raise PermissionError(1, "no links")

    def begin_first(self, target):
        with pytest.raises(SessionError, match="already exists"):
            SessionWriter(target, [TICK], METADATA)
        return replace_file(self, target)

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(Path, "replace", begin_first)
    with atomic_write(path, replace=False) as unfinished:
        unfinished.write_bytes(b"ours")
    assert path.read_bytes() == b"ours"
    assert [file.name for file in tmp_path.iterdir()] == ["s.mcap"]
