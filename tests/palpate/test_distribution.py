"""Contents of the wheel, and operation without optional packages."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from importlib.metadata import version
from pathlib import Path, PurePath
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from palpate.robot_io.extras import EXTRAS, install_command
from tests.palpate.cli import ROOT, assert_refused, run, run_process
from tests.palpate.presses import write_presses
from tests.palpate.sessions import cut

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOLDERS = ("palpate", "robot_io", "control", "estimation", "sim_backend", "calibration")
WITHOUT_EXTRAS = f"""
import sys
from importlib.machinery import PathFinder
class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {set(EXTRAS)} else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(PathFinder)] = Finder
"""
RUN = """
import json
from typer.testing import CliRunner
from palpate.commands import app
for arguments in json.loads(sys.argv[1]):
    result = CliRunner().invoke(app, arguments, prog_name="palpate")
    print(json.dumps([arguments, result.exit_code, result.stderr, result.stdout]))
"""


FEW_EFFECTS = f"""
sys.path.append({str(ROOT)!r})
import pytest
from tests.few_effects import try_few_effects
try_few_effects(pytest.MonkeyPatch(), few=("bias",))
"""


def run_without_extras(folder, *commands, prepare=""):
    """Exit code, stderr and stdout of each command, in a process without the modules of any extra."""
    done = run_process(json.dumps(commands), code=WITHOUT_EXTRAS + prepare + RUN, cwd=folder)
    assert done.returncode == 0, done.stderr
    return [json.loads(line)[1:] for line in done.stdout.splitlines()]


def git_files(*folders):
    listed = subprocess.run(
        ["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return listed.stdout.splitlines()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the wheel, and folder with the editable one, built from a copy of the tracked files."""
    if Version(version("setuptools")) < Version("80"):
        pytest.skip("the wheel needs setuptools 80")
    folder = tmp_path_factory.mktemp("built")
    tree, whole, editable = (folder / name for name in ("tree", "whole", "editable"))
    for name in git_files():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name, follow_symlinks=False)
    for place, hook in ((whole, "build_wheel"), (editable, "build_editable")):
        place.mkdir()
        code = f"from setuptools.build_meta import {hook}; {hook}({str(place)!r})"
        subprocess.run([sys.executable, "-c", code], cwd=tree, capture_output=True, check=True)
    return whole, editable


def test_wheel_holds_one_package_with_all_its_files(built):
    (wheel,) = built[0].glob("palpate-*.whl")
    names = set(ZipFile(wheel).namelist())
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"palpate"}
    sources = {name if name.startswith("palpate/") else f"palpate/{name}" for name in git_files(*FOLDERS)}
    links = {f"palpate/{folder}" for folder in FOLDERS}
    assert {name for name in names if ".dist-info/" not in name} == sources - links


def test_editable_installation_names_a_folder_and_needs_no_import_hook(built):
    """Type checkers and editors do not run import hooks."""
    (wheel,) = built[1].glob("palpate-*.whl")
    code = [name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name]
    assert [name.rpartition(".")[2] for name in code] == ["pth"]
    (folder,) = ZipFile(wheel).read(code[0]).decode().split()
    assert (Path(folder) / "palpate" / "py.typed").is_file()
    assert Path(folder).is_relative_to(built[1].parent)


def test_lazily_imported_packages_are_in_their_extra():
    extras = PROJECT["optional-dependencies"]
    for package, extra in EXTRAS.values():
        assert package in {Requirement(line).name for line in extras[extra]}
        assert package not in {Requirement(line).name for line in PROJECT["dependencies"]}
    everything = {extra for line in extras["all"] for extra in Requirement(line).extras} | {"arm"}
    assert {extra for _, extra in EXTRAS.values()} <= everything


NEEDS_EXTRA = {
    "sim": ["demo", "--out", "demo.mcap"],
    "view": ["inspect", "press.mcap"],
    "workbench": ["workbench", "press.csv", "--no-browser", "--port", "0"],
    "sweep": ["sweep", "paper", "--plan", "--out", "sweep"],
    "files": ["estimate", "press.h5"],
    "arm": ["probe", "--robot", str(ROOT / "robots" / "dynamixel_3dof.yaml"), "--yes"],
}


def test_missing_extra_is_named_where_it_is_needed(probed, tmp_path, monkeypatch):
    from palpate.commands import COMMANDS

    monkeypatch.chdir(tmp_path)  # where the commands run
    write_presses(tmp_path / "press.csv", speeds_m_s=(0.06, 0.1))
    cut(probed[0], tmp_path / "arm.mcap", 0.5)
    (tmp_path / "press.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    commands = [
        ["import", "press.csv", "-o", "press.mcap"],
        *([name, "press.mcap"] for name in ("info", "estimate", "compare")),
        ["diagnose", "press.csv", "--apply", "--out", "out"],
        ["report", "press.csv"],
        ["export", "press.mcap", "--stream", "contact", "-o", "press.parquet"],
        ["diagnose", "arm.mcap", "--out", "arm"],
    ]
    arm = install_command("arm")
    joint = ["diagnose", "arm.mcap", "--channel", "joint_1", "--out", "arm"]
    helps = [[name, "--help"] for name in COMMANDS]
    every = (*commands, *NEEDS_EXTRA.values(), joint, *helps)
    told = run_without_extras(tmp_path, *every, prepare=FEW_EFFECTS)
    seen = set()
    for command, (code, said, printed) in zip(commands, told, strict=False):
        assert code == 0, (command, said)
        # The report has no recording; the page and the recording of a session need an installation first.
        assert (install_command("view") in said) == (command[0] in {"estimate", "diagnose"}), said
        if "arm.mcap" in command:  # the contact needs no rigid-body model
            assert "contact" in printed
            assert f"left out: the package pin is not installed: {arm}" in " ".join(said.split())
        for need, extra in (("palpate inspect", "view"), ("palpate workbench", "workbench")):
            proposals = [line for line in said.splitlines() if need in line]
            assert all(line.startswith(f"  {install_command(extra)} && {need} ") for line in proposals)
            seen.update([need] * len(proposals))
    assert len(seen) == 2
    written = {PurePath(path).name for path in (tmp_path / "out").iterdir()}
    assert {"diagnosis.json", "report.html"} <= written
    assert "revisions.rrd" not in written
    told = told[len(commands) :]
    for extra, (code, said, printed) in zip(NEEDS_EXTRA, told, strict=False):
        assert (code, printed) == (2, ""), said
        assert said.splitlines()[-1].startswith("palpate: ")
        assert said.endswith(f"{install_command(extra)}\n")
    (code, refusal, _), *helped = told[len(NEEDS_EXTRA) :]
    assert (code, arm in " ".join(refusal.split())) == (2, True)
    assert [code for code, *_ in helped] == [0] * len(COMMANDS)


def test_sweep_without_a_simulator_is_refused_before_any_case_fails(tmp_path, monkeypatch):
    """The packages that draw its figures may be there, as dependencies of another project."""
    monkeypatch.setattr("palpate.commands.sweep.installed_engines", list)
    assert_refused(run("sweep", "paper", "--out", tmp_path / "paper"), install_command("sweep"))
    assert [*tmp_path.iterdir()] == []


CHECKOUT = {"url": ROOT.as_uri(), "dir_info": {}}
WHEEL = {"url": "file:///home/me/a%20b/palpate-0.1.0-py3-none-any.whl", "archive_info": {}}
GIT = {"url": "https://example.org/palpate.git", "vcs_info": {"vcs": "git", "commit_id": "1f"}}
TAG = GIT | {
    "vcs_info": {"vcs": "git", "commit_id": "1f", "requested_revision": "v0.3"},
    "subdirectory": "arm",
}


@pytest.mark.parametrize(
    ("origin", "where", "command"),
    [
        (None, ROOT, "pip install 'palpate[view]'"),
        (CHECKOUT | {"dir_info": {"editable": True}}, ROOT.parent, f"pip install -e '{ROOT}[view]'"),
        (CHECKOUT, ROOT, "pip install '.[view]'"),
        (WHEEL, ROOT, "pip install '/home/me/a b/palpate-0.1.0-py3-none-any.whl[view]'"),
        (GIT, ROOT, "pip install 'palpate[view] @ git+https://example.org/palpate.git'"),
        (
            TAG,
            ROOT,
            "pip install 'palpate[view] @ git+https://example.org/palpate.git@v0.3#subdirectory=arm'",
        ),
    ],
)
def test_extra_is_installed_from_where_palpate_was_installed(monkeypatch, tmp_path, origin, where, command):
    """An index of packages need not have palpate, and may have another version of it."""
    folder = tmp_path / "palpate-0.1.0.dist-info"
    folder.mkdir()
    if origin is not None:
        (folder / "direct_url.json").write_text(json.dumps(origin))
    monkeypatch.chdir(where)
    found = [metadata.Distribution.at(folder)]
    monkeypatch.setattr(metadata, "distributions", lambda name: found if name == "palpate" else [])
    assert install_command("view") == command
    assert shlex.split(install_command()) == [word.replace("[view]", "") for word in shlex.split(command)]


def test_make_compiles_only_what_is_imported():
    told = run_recipe('echo "[$$PYTHONDONTWRITEBYTECODE] $(WITH_PIP)"', PYTHONDONTWRITEBYTECODE="1")
    assert told.startswith("[] ")
    assert " --no-compile " in told


def run_recipe(recipe, *settings, **environment):
    """Output of a recipe that uses the variables of the Makefile."""
    done = subprocess.run(
        ["make", "--no-print-directory", *settings, "--eval", f"show:; @{recipe}", "show"],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


@pytest.mark.parametrize(("code", "is_repeated"), [(0, False), (2, True)])
def test_make_installs_with_pip_if_uv_fails(tmp_path, code, is_repeated):
    """As where packages come from an index that only pip's settings name."""
    uv = tmp_path / "uv"
    uv.write_text(f"#!/bin/sh\nexit {code}\n")
    uv.chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    told = run_recipe("$(call INSTALL,numpy)", "WITH_PIP=echo pip install", PATH=path)
    said = "uv failed (it does not read pip's settings): installing with pip ...\npip install numpy\n"
    assert told == (said if is_repeated else "")


def test_citation_names_the_version():
    assert f"version: {PROJECT['version']}\n" in (ROOT / "CITATION.cff").read_text()


IMPORTS = (  # one after the other, and what none of them up to here may have imported
    ("palpate", "numpy scipy pydantic typer"),
    ("palpate.commands", "numpy pydantic yaml mcap"),  # the list of commands
    ("palpate.commands.info", "pydantic yaml scipy pyarrow palpate.estimation.study palpate.sim_backend"),
    (
        "palpate.commands.sessions",
        "pyarrow scipy.spatial scipy.optimize plotly rerun pinocchio zenoh nicegui",
    ),
    ("palpate.study", "pyarrow scipy.linalg scipy.spatial plotly jinja2 pinocchio mujoco rerun"),
)


def test_imports_load_no_unneeded_library():
    code = "import importlib, sys\n" + "".join(
        f"importlib.import_module({name!r})\n"
        f"too_many = {set(slow.split())} & set(sys.modules)\n"
        f"assert not too_many, ({name!r}, too_many)\n"
        for name, slow in IMPORTS
    )
    done = run_process(code=code)
    assert done.returncode == 0, done.stderr


def test_python_control_is_found_in_a_checkout(tmp_path):
    """`control` at the root has no `__init__.py`: a package of that name anywhere on the path comes first."""
    (tmp_path / "control").mkdir()
    (tmp_path / "control" / "__init__.py").write_text("")
    code = (
        "import sys; sys.path[:0] = ['.']; import control, palpate.control.loop.task; print(control.__file__)"
    )
    done = run_process(code=code, env=os.environ | {"PYTHONPATH": str(tmp_path)})
    assert done.stdout == f"{tmp_path / 'control' / '__init__.py'}\n", done.stderr
