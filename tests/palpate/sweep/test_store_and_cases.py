"""Addresses, and results that land under them."""

import os
import shutil
import subprocess
import sys
from collections import deque
from contextlib import suppress
from types import SimpleNamespace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from palpate.robot_io.errors import InputError, PalpateError
from palpate.sweep import Case, Cluster, ResultStore, case, run_cases, runner
from palpate.sweep.case import code_version, refuse_other_files
from palpate.sweep.rows import BOUND, HIGH, LOW, TRUE, error_table, errors_of
from palpate.sweep.runner import run_one
from tests.palpate.cli import ROOT

BASE = Case("tests.palpate.sweep.slow_work:work", {"k": 500, "noise": [0.0, 0.1]}, 1)


@pytest.mark.parametrize(
    "other",
    [
        Case("tests.palpate.sweep.slow_work:failing", BASE.parameters, 1),
        Case(BASE.task, {"k": 500, "noise": [0.1, 0.0]}, 1),
        Case(BASE.task, {"k": 501, "noise": [0.0, 0.1]}, 1),
        Case(BASE.task, BASE.parameters, 2),
    ],
)
def test_address_depends_on_all_inputs(other):
    assert other.address != BASE.address


def test_address_depends_neither_on_parameter_order_nor_exists_without_json_form():
    with pytest.raises(ValueError, match="JSON compliant"):
        _ = Case(BASE.task, {"k": float("nan")}).address
    assert Case(BASE.task, {"noise": [0.0, 0.1], "k": 500}, 1).address == BASE.address


def test_task_code_change_changes_the_address(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "little_work.py").write_text("def work(parameters, seed):\n    return [{}]\n")
    before = Case("little_work:work", {}).address
    code_version.cache_clear()
    assert Case("little_work:work", {}).address == before
    (tmp_path / "little_work.py").write_text("def work(parameters, seed):\n    return [{'more': 1}]\n")
    code_version.cache_clear()
    assert Case("little_work:work", {}).address != before
    sys.modules.pop("little_work", None)


def test_physics_change_changes_the_address(tmp_path, monkeypatch):
    """Or results of the old contact law would be taken for those of the new one."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "little_physics").mkdir()
    law = tmp_path / "little_physics" / "law.py"
    law.write_text("STIFFNESS = 1\n")
    monkeypatch.setattr(case, "_PHYSICS", ("little_physics",))
    versions = []
    for stiffness in (1, 1, 2):
        law.write_text(f"STIFFNESS = {stiffness}\n")
        code_version.cache_clear()
        versions.append(code_version("tests.palpate.sweep.slow_work"))
    code_version.cache_clear()
    assert versions[0] == versions[1] != versions[2]


def test_worker_with_other_code_gives_no_result(tmp_path):
    """One that has joined a scheduler later; its own address of the case is another."""
    store = ResultStore(tmp_path)
    with pytest.raises(PalpateError, match="runs a different version of palpate"):
        run_one(BASE, Case(BASE.task, BASE.parameters, 7).address, tmp_path)
    assert store.finished() == set()


def test_missing_task_is_refused():
    with pytest.raises(InputError, match="Python does not find it"):
        _ = Case("no_such_work:at_all", {}).address


def test_results_are_read_back_in_order_packed_or_not(tmp_path):
    store = ResultStore(tmp_path / "results")
    for name in "abc":
        store.write(name, [{"text": name, "number": index} for index in range(2)])
    store.pack()
    store.write("d", [{"text": "d", "list": [1.0, 2.0]}])
    store.write("e", [{"number": 5}])
    store.pack()  # two cases with other columns in one pack
    store.write("f", [{"number": 6}])
    assert store.finished() == set("abcdef")
    assert store.rows("ef") == [{"number": 5}, {"number": 6}]
    rows = store.rows(["d", "b", "missing", "a"])
    assert [row["text"] for row in rows] == ["d", "b", "b", "a", "a"]
    assert rows[0]["list"] == [1.0, 2.0]


def test_interrupted_pack_counts_each_result_once(tmp_path):
    store = ResultStore(tmp_path)
    store.write("a", [{"number": 1}])
    store.write("b", [{"number": 2}])
    kept = {path: path.read_bytes() for path in tmp_path.iterdir()}
    store.pack()
    for path, data in kept.items():
        path.write_bytes(data)
    assert [row["number"] for row in store.rows("ab")] == [1, 2]
    store.pack()
    assert [row["number"] for row in store.rows("ab")] == [1, 2]


def test_partially_written_results_are_ignored(tmp_path):
    store = ResultStore(tmp_path)
    store.write("a", [{"number": 1}])
    (tmp_path / ".123.b.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:50])
    assert store.finished() == {"a"}
    assert len(store.rows("ab")) == 1
    (tmp_path / "a.parquet").write_bytes(b"PAR1 nothing PAR1")
    with pytest.raises(InputError, match=r"a\.parquet.*delete it, and the case is computed again"):
        ResultStore(tmp_path).rows("a")
    (tmp_path / "a.parquet").rename(tmp_path / "pack-0.parquet")
    with pytest.raises(InputError, match=r"delete it, and all its cases are computed again"):
        store.finished()


def test_folder_with_other_files_is_refused_and_one_with_results_is_not(tmp_path):
    for _ in range(2):
        refuse_other_files(tmp_path / "out")  # does not exist yet, then is empty
        (tmp_path / "out").mkdir(exist_ok=True)
    (tmp_path / "out" / "notes.txt").touch()
    with pytest.raises(InputError, match="out: holds other files; choose another"):
        refuse_other_files(tmp_path / "out")
    with pytest.raises(InputError, match=r"results folder .*notes\.txt/results: cannot be created"):
        ResultStore(tmp_path / "out" / "notes.txt" / "results")
    ResultStore(tmp_path / "out" / "results")
    refuse_other_files(tmp_path / "out")


@pytest.mark.parametrize("count", [3, 4])
def test_file_of_too_many_rows_is_not_read(tmp_path, monkeypatch, count):
    monkeypatch.setattr(case, "_MOST_ROWS", 3)
    store = ResultStore(tmp_path)
    store.write("a", [{"x": 1.0}] * count)
    if count == 3:
        assert len(store.rows("a")) == 3
        return
    with pytest.raises(InputError, match=r"a\.parquet: has 4 rows; the limit is 3; delete it"):
        store.rows("a")


def write(path, **columns):
    pq.write_table(pa.table(columns), path)


def test_file_under_another_case_name_does_not_count(tmp_path):
    store = ResultStore(tmp_path)
    store.write("a", [{"number": 1}])
    shutil.copy(tmp_path / "a.parquet", tmp_path / "b.parquet")
    for ask in (store.finished, lambda: store.rows("ab"), store.pack):
        with pytest.raises(InputError, match=r"b\.parquet: holds results of cases other .*\(a\).*delete it"):
            ask()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.parquet", "b.parquet"]


@pytest.mark.parametrize(
    "change",
    [{"number": 2.0}, {"number": "one"}, {"part": 3.0}, {"error": "no touch"}, {"part": None}],
    ids=str,
)
@pytest.mark.parametrize("names", [("a.parquet", "pack-1.parquet"), ("pack-1.parquet", "a.parquet")])
def test_contradictory_files_of_a_case_are_refused(tmp_path, change, names):
    """Also if one has a number where the other has none, and if one has no such column."""
    store = ResultStore(tmp_path)
    result = {"number": 1.0, "part": float("nan"), "error": "", "seconds": 1.0}
    one, other = (
        {name: [value] for name, value in row.items() if value is not None}
        for row in (result, result | change)
    )
    for name in names:
        write(tmp_path / name, address=["a"], **one)
    assert store.rows("a")[0]["number"] == 1.0
    write(tmp_path / names[1], address=["a"], **other)
    with pytest.raises(InputError, match="another file has a different result for case a"):
        store.rows("a")


@pytest.mark.parametrize("name", ["a.parquet", "pack-1.parquet"])
@pytest.mark.parametrize(
    ("columns", "why"),
    [
        ({"number": [1]}, "has no column 'address'"),
        ({"address": [1]}, "its column 'address' is not text"),
        ({"address": ["a", None]}, "its column 'address' is not text"),
    ],
)
def test_file_without_its_case_is_refused(name, columns, why, tmp_path):
    write(tmp_path / name, **columns)
    for ask in (ResultStore(tmp_path).finished, lambda: ResultStore(tmp_path).rows("a")):
        with pytest.raises(InputError, match=f"{name}: {why}"):
            ask()


def test_file_with_a_column_twice_is_refused(tmp_path):
    table = pa.Table.from_arrays([["a"], [1.0], [2.0]], ["address", "x", "x"])
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"a\.parquet: has no column 'address', or a column twice"):
        ResultStore(tmp_path).rows(["a"])


@pytest.mark.parametrize("packed", [False, True])
def test_dropped_results_are_gone_and_others_stay(tmp_path, packed):
    store = ResultStore(tmp_path)
    for name in "abc":
        store.write(name, [{"x": 1.0}])
    if packed:
        store.pack()
    store.drop(["a", "b"])
    assert store.finished() == {"c"}
    store.drop(["c"])
    assert list(tmp_path.iterdir()) == []


def test_named_pipe_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="not a regular file"):
        ResultStore(tmp_path).finished()


SCRIPT = """
from pathlib import Path
from palpate.sweep import Case, Cluster, ResultStore, run_cases
case, progress = Case("tests.palpate.sweep.slow_work:failing", {"what": "luck"}, 3), []
report = run_cases([case, case], ResultStore(Path()), Cluster(workers=1), lambda *now: progress.append(now))
print((report.finished_before, report.finished_now, report.failures), progress)
"""  # runs once, although it has no guard by `__name__`


def test_failed_case_of_a_script_stores_its_error_and_is_not_repeated(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    ended = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert (ended.stdout, "Traceback" in ended.stderr) == ("(0, 1, ()) [(0, 1), (1, 1)]\n", False)
    store, failed = ResultStore(tmp_path), Case("tests.palpate.sweep.slow_work:failing", {"what": "luck"}, 3)
    (row,) = store.rows([failed.address])
    assert row["error"].startswith("ValueError: no luck")
    assert row["seed"] == 3
    assert run_cases([failed], store).finished_before == 1


def test_result_with_other_column_types_is_refused_by_name(tmp_path):
    store = ResultStore(tmp_path)
    store.write("a", [{"number": 1}])
    write(tmp_path / "b.parquet", address=["b"], number=[b"text"])
    for read in (lambda: store.table("ab"), store.pack):
        with pytest.raises(InputError, match=r"b\.parquet: its columns do not fit.*delete it"):
            read()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.parquet", "b.parquet"]


def test_flipped_bit_never_changes_a_result(tmp_path):
    store, path, rows = ResultStore(tmp_path), tmp_path / "a.parquet", [{"number": 1.5, "name": "press"}]
    store.write("a", rows)
    whole = path.read_bytes()
    for place in range(4, len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with suppress(InputError):
            assert store.rows("a") == rows


def test_errors_are_rms_over_bounds_and_intervals_are_checked():
    names = ("k", f"{TRUE}k", f"{BOUND}k", f"{LOW}k", f"{HIGH}k")
    rows = [
        dict(zip(names, values, strict=True))
        for values in (
            (103.0, 100.0, 1.0, 99.0, 107.0),
            (96.0, 100.0, 1.0, 92.0, 99.0),  # below the truth
            (105.0, 100.0, 1.0, 101.0, 109.0),  # above it
            (100.0, 100.0, 1.0, None, None),  # states none
            (100.0, 100.0, None, 100.0, 100.0),  # exact
        )
    ]
    others = ({"k": 2.0, f"{TRUE}k": 0.0}, {"k": None, f"{TRUE}k": 5.0}, {"k": -5.5, f"{TRUE}k": -5.0})
    errors = errors_of([*rows, *others], "k")
    assert errors.relative == pytest.approx([0.03, -0.04, 0.05, 0.0, 0.0, 0.1])
    assert errors.at_zero.tolist() == [2.0]
    assert errors.over_bound == pytest.approx((50.0 / 4.0) ** 0.5)
    assert errors.covered == pytest.approx(2.0 / 4.0)


@pytest.mark.parametrize("count", [1, 3])
def test_files_with_more_and_fewer_rows_of_a_case_disagree(tmp_path, count):
    store = ResultStore(tmp_path)
    store.write("a", [{"x": 1.0}, {"x": 2.0}])
    store.write("b", [{"x": 0.0}])
    store.pack()
    store.write("a", [{"x": float(number)} for number in range(1, 1 + count)])
    with pytest.raises(InputError, match="another file has a different result for case a"):
        store.rows(["a"])


def test_repeated_result_may_have_taken_another_time(tmp_path):
    store = ResultStore(tmp_path)
    for seconds in (1.0, 2.0):
        store.write("a", [{"x": 1.0, "seconds": seconds}])
        store.write("b", [{"x": 0.0, "seconds": seconds}])
        store.pack()
    assert [row["x"] for row in store.rows(["a", "b"])] == [1.0, 0.0]


def test_case_that_crashes_its_worker_is_reported_and_others_finish(tmp_path):
    cases = [Case("tests.palpate.sweep.slow_work:fatal", {"what": "all"}, seed) for seed in range(4)]
    report = run_cases(cases, ResultStore(tmp_path), Cluster(workers=2))
    assert report.failures == ("case {'what': 'all'}: its worker process died 4 times",)
    assert report.finished_now == 3
    rows = ResultStore(tmp_path).rows([case.address for case in cases])
    assert [(row["seed"], row["square"]) for row in rows] == [(0, 0), (2, 4), (3, 9)]


def test_error_table_is_in_percent_and_marks_the_smallest_worst_error():
    bounds = {f"{TRUE}k": 100.0, f"{BOUND}k": 1.0, f"{LOW}k": 90.0, f"{HIGH}k": 103.5, "error": ""}
    known = {"even": (103.0, 97.0, 103.0, 97.0), "spiky": (104.0, 100.0, 100.0, 100.0)}
    rows = [bounds | {"estimator": name, "k": k} for name in ("spiky", "even") for k in known[name]]
    rows[0][f"{LOW}k"] = 102.0  # of four intervals one misses the truth
    rows.insert(0, {f"{TRUE}k": 100.0, "error": "", "estimator": "silent"})  # estimates other parameters
    even, spiky, silent = error_table("errors", "Errors", rows, best_first=True).rows
    assert silent[:3] == ("silent", None, None)
    assert even == ("even", pytest.approx(3.0), pytest.approx(3.0), pytest.approx(3.0), 100.0, 0)
    assert spiky == ("spiky", pytest.approx(4.0), pytest.approx(1.0), pytest.approx(2.0), 75.0, 0)


class Scheduler:
    """Stands for `distributed`, with one worker in this process; also what its `as_completed` returns."""

    def __init__(self, monkeypatch, *, workers=1, code=None, sees_folder=True, lost_after=10**9):
        self.workers, self.code, self.sees_folder, self.lost_after = workers, code, sees_folder, lost_after
        self.submitted, self.waiting, self.most_waiting = [], deque(), 0
        self.scheduler = SimpleNamespace(addr="tcp://s")
        module = SimpleNamespace(Client=self.connect, as_completed=lambda futures: self.add(*futures))
        monkeypatch.setitem(sys.modules, "distributed", module)

    def connect(self, address, timeout):
        if self.workers is None:
            raise OSError("timed out")
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def wait_for_workers(self, count, timeout):
        if self.workers < count:
            raise TimeoutError

    def run(self, function, mark, modules):
        is_there, code = function(mark, modules)
        return {"tcp://w": (is_there and self.sees_folder, self.code or code)}

    def submit(self, function, *arguments, key, pure):
        future = SimpleNamespace(key=key, status="finished", exception=lambda: future.problem)
        try:
            function(*arguments)
        except PalpateError as error:
            future.status, future.problem = "error", error
        self.submitted.append(key.split("-")[1])
        future.status = "lost" if len(self.submitted) > self.lost_after else future.status
        return future

    def add(self, *futures):
        self.waiting.extend(futures)
        self.most_waiting = max(self.most_waiting, len(self.waiting))
        return self

    def __iter__(self):
        while self.waiting:
            yield self.waiting.popleft()


def squares(count):
    return [
        Case("tests.palpate.sweep.slow_work:fatal", {"what": "all"}, seed) for seed in range(2, 2 + count)
    ]


def test_scheduler_gets_a_few_cases_at_a_time_and_all_results_arrive(tmp_path, monkeypatch):
    def check(case):
        if case.seed == 4:
            raise PalpateError("no recording")

    packed, pack = [], ResultStore.pack
    monkeypatch.setattr(ResultStore, "pack", lambda store: packed.append(True) or pack(store))
    monkeypatch.setattr(runner, "_PACK_EVERY", 4)
    monkeypatch.setattr(runner, "_AHEAD", 3)
    monkeypatch.setattr(Case, "check", check)
    scheduler, store, cases = Scheduler(monkeypatch), ResultStore(tmp_path), squares(7)
    progress = []
    report = run_cases(cases, store, Cluster("tcp://s"), lambda *now: progress.append(now))
    assert progress == [(done, 7) for done in range(8)]
    assert (report.finished_now, report.failures) == (6, ("case {'what': 'all'}: no recording",))
    addresses = [case.address for case in cases]
    assert [row["square"] for row in store.rows(addresses)] == [4, 9, 25, 36, 49, 64]
    assert scheduler.submitted == addresses
    assert scheduler.most_waiting == 3
    assert len(packed) == 2  # after four results, and at the end
    assert [path.name[:5] for path in tmp_path.iterdir()] == ["pack-"]
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"workers": None}, "scheduler tcp://s: does not answer"),
        ({"workers": 0}, "scheduler tcp://s: has no workers; start one with: dask worker"),
        ({"sees_folder": False}, "worker tcp://w: cannot access .*; use a shared disk for --out"),
        ({"code": ["other"]}, "worker tcp://w: runs a different version of palpate"),
        ({"lost_after": 0}, "the scheduler tcp://s was lost; finished cases are saved"),
    ],
)
def test_scheduler_that_cannot_serve_is_refused(tmp_path, monkeypatch, faults, words):
    scheduler, store = Scheduler(monkeypatch, **faults), ResultStore(tmp_path)
    with pytest.raises(PalpateError, match=words):
        run_cases(squares(2), store, Cluster("tcp://s"))
    assert len(store.finished()) == len(scheduler.submitted) == (2 if "lost_after" in faults else 0)
    assert not list(tmp_path.glob(".*"))
