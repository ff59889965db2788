"""Meaningless options are refused, and errors use the caller's words."""

import ast
import os
import re
import sys

import numpy as np
import pytest

from palpate.common.failures import python_wording
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from palpate.study import Study
from tests.palpate import synthetic
from tests.palpate.cli import ROOT, assert_refused, run
from tests.palpate.presses import write_presses, write_table
from tests.palpate.sessions import synthetic_session

WHERE = ImportOptions(where={"run": "0,2"})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--estimator", "lsq,lsq"), ("lsq,lsq", "twice")),
        (("--context", "force_N"), ("--context force_N", "already used")),
        (("--tip-frame", "zz"), ("--tip-frame zz", "--urdf")),
        (("--runs", "0"), ("'--runs': '0' should be greater than or equal to 1", "--help")),
        (("--runs", "many"), ("'--runs': 'many' should be a valid integer (see",)),
        (("--held-out", "1,1"), ("--held-out 1,1: a run is named twice",)),
        (("--held-out", "0,1,2,3"), ("contact", "all runs are held out; leave at least one run to fit to")),
        (("--urdf", "DATA"), ("hardening.csv", "not a readable URDF")),
        (("--urdf", "ARM", "--tip-frame", "zz"), ("arm.urdf: no frame is called 'zz'", "Valid:")),
    ],
)
def test_meaningless_options_of_estimate_are_refused(options, words, hardening, tmp_path):
    (tmp_path / "arm.urdf").write_text(synthetic.urdf())
    places = {"DATA": hardening, "ARM": tmp_path / "arm.urdf"}
    assert_refused(run("estimate", hardening, *(places.get(each, each) for each in options)), *words)


def test_runs_of_a_session_are_chosen_like_those_of_its_data_file(hardening, tmp_path):
    assert run("import", hardening, "-o", tmp_path / "x.mcap").exit_code == 0
    few, all_runs = open_source(tmp_path / "x.mcap", WHERE), open_source(tmp_path / "x.mcap")
    assert few.channels[0].runs.tolist() == few.tared(["contact"])[0].runs.tolist() == [0, 2]
    assert len(open_source(hardening, WHERE).channels[0]) == len(few.channels[0]) < len(all_runs.channels[0])
    refused = run("diagnose", tmp_path / "x.mcap", "--where", "run=0,77")
    assert_refused(refused, "--where run=0,77", "Available: 0, 1")


@pytest.mark.parametrize("command", ["export", "revisions"])
def test_missing_folder_of_revisions_is_refused(command, hardening, tmp_path):
    assert_refused(run(command, hardening, "--folder", tmp_path / "nope"), "--folder", "no such folder")


def test_error_for_a_missing_revision_names_the_folder(hardening, tmp_path):
    result = run("export", hardening, "--folder", tmp_path, "--revision", 99)
    assert_refused(result, "no revision 99 in", str(tmp_path), "none yet")


def test_package_without_drivers_is_refused(tmp_path, monkeypatch):
    asked = ("probe", "-o", tmp_path / "x.mcap", "--drivers")
    assert_refused(run(*asked, "os"), "--drivers os", "holds no driver")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "drivers_that_leave.py").write_text("import sys; sys.exit(0)")
    assert_refused(run(*asked, "drivers_that_leave"), "drivers_that_leave", "SystemExit")
    assert "drivers_that_leave" not in sys.modules
    assert not (tmp_path / "x.mcap").exists()


def test_oversized_urdf_is_not_read_whole(hardening, tmp_path):
    path = tmp_path / "arm.urdf"
    path.touch()
    os.truncate(path, 2**40)  # takes no room on the disk
    assert_refused(run("estimate", hardening, "--urdf", path), "arm.urdf", "larger than")


def test_error_for_invalid_urdf_names_the_session(tmp_path):
    synthetic_session(tmp_path / "x.mcap", urdf="<robot name='r'><link name='l'/></robot>")
    result = run("estimate", tmp_path / "x.mcap", "--model", "rigid_body_fitted")
    assert_refused(result, "x.mcap, its URDF: has no movable joint")


OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("use --unit force=mN or --unit x=mm", 'use units={"force": "mN"} or units={"x": "mm"}'),
        ("as in --unit displacement=m --unit force=N", 'as in units={"displacement": "m", "force": "N"}'),
        ("as in --column force='column 3' --unit force=N --column time=t",
         'as in columns={"force": "column 3", "time": "t"}, units={"force": "N"}'),
        ("add --column run='no. 1', it says", 'add columns={"run": "no. 1"}, it says'),
        ("add --unit force=0.1N/V. Valid: N", 'add units={"force": "0.1N/V"}. Valid: N'),
        ("takes --where run=0,2; --column, --unit and --fresh-runs are",
         'takes where={"run": "0,2"}; columns=, units= and fresh=True are'),
        ("choose a part with --where to keep it", "choose a part with where= to keep it"),
        ("--context torque 1: rename", "context= torque 1: rename"),
        ("--context heat: a signal is called that", 'context=["heat"]: a signal is called that'),
        ("x.csv: --runs 3: no contact; add --runs N", "x.csv: runs=3: no contact; add runs=N"),
        ("a, b; choose one with --channel", "a, b; choose one with channel="),
        ("--channel joint_9: no such channel", 'channel="joint_9": no such channel'),
        ("Choose with --model: a, b", "Choose with model=: a, b"),
        ("the arm's URDF (--urdf FILE)", "the arm's URDF (arm=\"FILE\")"),
        ("add --effect my/mine.py:Mine", 'add effects=["my/mine.py:Mine"]'),
        ("--from 3 says channel; leave out --fresh", "start=3 says channel; leave out fresh=True"),
        ("(palpate diagnose --apply, palpate add --fresh)",
         "(study.diagnose(apply=True), study.add(fresh=True))"),
        ("a--b and -1N and --unit-less", "a--b and -1N and --unit-less"),
    ],
)  # fmt: skip
def test_options_become_keywords(text, expected):
    assert python_wording(text) == expected


def test_every_option_that_estimation_names_has_a_keyword():
    unknown = {}
    for file in (ROOT / "estimation").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                left = set(OPTION.findall(python_wording(node.value))) - {"--experiment"}  # of palpate probe
                unknown |= {f"{file.name}: {option}": node.lineno for option in left}
    assert not unknown


def test_errors_name_keywords_in_python_and_options_on_the_command_line(tmp_path):
    t = np.arange(0.0, 2.0, 0.01)
    table = {"clock": t, "depth": 0.01 * np.sin(3 * t), "load": np.sin(3 * t)}
    file = write_table(tmp_path / "unknown.csv", **table)
    for data in (file, table):
        with pytest.raises(InputError, match=r"(columns|units)=") as error:
            Study(data)
        assert not OPTION.search(str(error.value))
    study = Study(write_presses(tmp_path / "press.csv"), keep=False)
    with pytest.raises(InputError, match=r'^channel="joint_9": no such channel'):
        study.compare("joint_9")
    assert_refused(run("compare", file), "--unit displacement=m --unit force=N")
    assert_refused(
        run("compare", tmp_path / "press.csv", "--channel", "joint_9"), "--channel joint_9: no such"
    )
