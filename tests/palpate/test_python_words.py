"""Errors of `palpate.Study` name its keywords, and those of commands their options."""

import ast
import re

import numpy as np
import pytest

from palpate.common.failures import in_python
from palpate.study import Study
from robot_io.errors import InputError
from tests.palpate.cli import ROOT, assert_refused, run
from tests.palpate.presses import write_presses, write_table

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("say --unit force=mN or --unit x=mm", 'say units={"force": "mN"} or units={"x": "mm"}'),
        ("as in --unit displacement=m --unit force=N", 'as in units={"displacement": "m", "force": "N"}'),
        ("add --column run='no. 1', it says", 'add columns={"run": "no. 1"}, it says'),
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
    assert in_python(text) == expected


def test_every_option_that_estimation_names_has_a_keyword():
    unknown = {}
    for file in (ROOT / "estimation").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                left = set(OPTION.findall(in_python(node.value))) - {"--experiment"}  # of palpate probe
                unknown |= {f"{file.name}: {option}": node.lineno for option in left}
    assert not unknown


def test_from_python_errors_name_keywords_and_from_the_command_line_options(tmp_path):
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
