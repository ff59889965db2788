"""Outputs never replace files unasked or inputs at all, and any file name works."""

import io
import json
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stderr
from html import unescape
from pathlib import Path

import pytest

from palpate.common import console
from palpate.common.console import as_shell_word, display_path, shell_path
from palpate.common.files import (
    atomic_write,
    atomic_write_all,
    different_files,
    existing_file,
    output_file,
    spare_files,
)
from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session import Column, Event, Session, SessionMetadata, Stream, write_session
from tests.few_effects import try_few_effects
from tests.palpate.cli import ROOT, assert_refused, done, run, run_process
from tests.palpate.sessions import cut

NASTY = (
    "a b.mcap",
    "[bold]x[red].mcap",
    "it's \\ [i].mcap",
    "$(id)`id`.mcap",
    "new\nline\x1b[2J.mcap",
    "-x.mcap",
    "ü.mcap",
    "\udcff.mcap",  # a name that is no UTF-8
)


@pytest.fixture
def session(probed, tmp_path):
    """A copy of a session that a test may spoil."""
    return Path(shutil.copy(probed[0], tmp_path / "s.mcap"))


def test_input_files_are_never_overwritten(session, hardening, tmp_path):
    (tmp_path / "link.yaml").symlink_to(session)
    data = Path(shutil.copy(hardening, tmp_path / "data.csv"))
    for read, command in (
        (session, ("export", session, "-o", session, "--force")),
        (session, ("export", session, "-o", tmp_path / "link.yaml", "--force")),
        (data, ("export", data, "-o", data, "--force")),
        (session, ("inspect", session, "--save", session, "--force")),
        (session, ("inspect", session, "--screenshot", session, "--force")),
        (session, ("merge", session, data, "-o", session)),
    ):
        before = read.read_bytes()
        assert_refused(run(*command), "is the input")
        assert read.read_bytes() == before


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("diagnose", "DATA", "--out"), "report.html"),
        (("diagnose", "DATA", "--out"), "diagnosis.json"),
        (("compare", "DATA", "--out"), "comparison.json"),
        (("add", "DATA", "cubic_stiffness", "--out"), "revisions.rrd"),
        (("probe", "-o"), "x.mcap"),
        (("import", "DATA", "-o"), "x.mcap"),
        (("inspect", "SESSION", "--save"), "x.rrd"),
        (("export", "SESSION", "--stream", "tick", "-o"), "t.csv"),
        (("merge", "SESSION", "OTHER", "-o"), "x.mcap"),
        (("calibrate", "encoder", "--pose", "home", "-o"), "c.yaml"),
    ],
)
def test_existing_files_are_kept_without_confirmation(command, name, session, hardening, tmp_path):
    there = tmp_path / "there"
    there.mkdir()
    (there / name).write_text("precious")
    out = there if "--out" in command else there / name
    known = {"DATA": hardening, "SESSION": session}
    if "OTHER" in command:
        known["OTHER"] = cut(session, tmp_path / "other.mcap", 0.9)
    assert_refused(run(*(known.get(one, one) for one in command), out), name, "already exists")
    assert {file.name: file.read_text() for file in there.iterdir()} == {name: "precious"}


def test_report_replaces_its_own_page_alone(without_figures, hardening, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        result = run("report", hardening, "--json")
        assert json.loads(result.stdout) == {"file": str(hardening), "report": "report.html"}
    Path("mine.html").write_text("<html>palpate</html>")
    assert_refused(run("report", hardening, "-o", "mine.html"), "already exists", "--force")


def test_report_states_the_commands_that_repeat_it(without_figures, hardening, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = f"{hardening.stem}-palpate"
    assert run("add", hardening, "cubic_stiffness").exit_code == 0
    first = run("report", hardening)
    assert f"palpate diagnose {hardening} --out {folder}" in " ".join(first.stderr.split())
    assert f"palpate add {hardening} cubic_stiffness --fresh\npalpate report {hardening}" in read_page(
        "report.html"
    )
    try_few_effects(monkeypatch)
    assert run("diagnose", hardening, "--out", folder).exit_code == 0
    assert "palpate diagnose" not in run("report", hardening).stderr
    assert f"palpate diagnose {hardening} --out {folder}\npalpate add" in read_page("report.html")


def read_page(name):
    return unescape(Path(name).read_text())


def test_force_option_replaces_outputs_but_never_inputs(without_figures, hardening, tmp_path):
    (tmp_path / "report.html").write_text("old")
    assert run("compare", hardening, "--out", tmp_path, "--force").exit_code == 0
    assert "<html" in (tmp_path / "report.html").read_text()
    data = Path(shutil.copy(hardening, tmp_path / "data.csv"))
    with pytest.raises(InputError, match="is the input"):
        spare_files(tmp_path, ["*.csv"], force=True, keep=[data])


@pytest.mark.parametrize("command", [("diagnose", "DATA"), ("compare", "DATA"), ("add", "DATA", "bias")])
def test_force_without_a_folder_is_refused(command, hardening):
    told = run(*(hardening if word == "DATA" else word for word in command), "--force")
    assert_refused(told, "--force has no effect without --out")


def test_plots_and_pictures_replace_neither_files_nor_each_other(session, tmp_path):
    folder = tmp_path / "plots"
    folder.mkdir()
    page = folder / "plots.html"
    page.write_text("precious")
    asked = ("inspect", session, "--save", tmp_path / "x.rrd")
    assert_refused(run(*asked, "--plots", folder), "plots.html", "already exists", "--force")
    assert page.read_text() == "precious"
    assert_refused(run(*asked, "--screenshot", tmp_path / "x.rrd"), "is given twice")
    assert_refused(run(*asked, "--plots", folder, "--screenshot", page, "--force"), "is given twice")
    assert not (tmp_path / "x.rrd").exists()
    different_files(tmp_path / "a", None, tmp_path / "b", None)


@pytest.mark.slow
@pytest.mark.filterwarnings("error:.*surrogates")
def test_names_that_are_no_utf8_are_read_and_written(session, hardening, tmp_path, monkeypatch):
    odd = os.fsdecode(b"\xe4\xff\x1b[2J")
    data, log = tmp_path / f"{odd}.csv", session.rename(tmp_path / f"{odd}.mcap")
    shutil.copy(hardening, data)
    for command in (
        ("import", data, "-o", tmp_path / f"{odd}2.mcap"),
        ("export", tmp_path / f"{odd}2.mcap", "--stream", "contact", "-o", tmp_path / f"{odd}.parquet"),
        ("import", tmp_path / f"{odd}.parquet", "-o", tmp_path / f"{odd}3.mcap"),
        ("export", log, "--stream", "tick", "-o", tmp_path / f"{odd}3.csv"),
        ("merge", tmp_path / f"{odd}2.mcap", tmp_path / f"{odd}3.mcap", "-o", tmp_path / f"{odd}4.mcap"),
        ("inspect", log, "--save", tmp_path / f"{odd}.rrd"),
        ("report", log, "-o", tmp_path / f"{odd}.html"),
        ("compare", data, "--out", tmp_path / odd),
        ("replay", log, "-o", tmp_path / f"{odd}5.mcap"),
    ):
        monkeypatch.setattr("sys.argv", ["palpate", *map(str, command)])
        done(*command)
    kept = [Session.open(tmp_path / f"{odd}{number}.mcap").metadata for number in (2, 3, 4)]
    assert "imported from ??" in kept[0].extra["source"]
    assert all(r"\xe4\xff\x1b[2J" in one.command_line for one in kept)


@pytest.mark.parametrize("option", ["--out", "--out=", "--model"])
def test_empty_argument_is_no_name(option, hardening):
    empty = (option,) if option.endswith("=") else (option, "")
    assert_refused(run("diagnose", hardening, *empty), "empty", option)


def test_unwritable_folder_is_refused_before_any_work(hardening):
    assert_refused(run("probe", "-o", "/proc/x.mcap"), "output folder /proc", "cannot be written to")
    told = run("diagnose", hardening, "--out", hardening)
    assert_refused(told, "hardening.csv: is a file, not a folder")
    with pytest.raises(InputError, match="is not a regular file, and is not replaced"):
        output_file(Path("/dev/null"), force=True)


@pytest.mark.parametrize("device", ["/dev/zero", "pipe"])
def test_pipes_and_devices_are_not_read(device, hardening, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    path = tmp_path / device
    with pytest.raises(InputError, match="is a device or a pipe"):
        existing_file(path, "session")
    assert_refused(
        run("estimate", hardening, "--model", "rigid_body", "--urdf", path), "URDF", "a device or a pipe"
    )
    for option in ("--robot", "--scenario", "--experiment"):
        assert_refused(run("probe", option, path, "-o", tmp_path / "a.mcap"), str(path))


def test_unfinished_file_is_not_written(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")

    def write_half():
        with atomic_write(path) as unfinished:
            unfinished.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"cannot write .*x\.txt: No space"):
        write_half()
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("x.txt", "old")]


def test_set_of_files_is_written_atomically(tmp_path):
    paths = [tmp_path / name for name in ("a.json", "b.html")]
    with pytest.raises(KeyboardInterrupt), atomic_write_all(dict.fromkeys(paths, "text")):
        raise KeyboardInterrupt
    with (
        pytest.raises(InputError, match="missing"),
        atomic_write_all({paths[0]: "", tmp_path / "missing/c": ""}),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
    with atomic_write_all(dict.fromkeys(paths, "text")):
        assert not any(path.exists() for path in paths)
    assert sorted(tmp_path.iterdir()) == paths


def test_concurrent_imports_into_one_file_keep_the_first(tmp_path):
    """Both have found the name free; the slower one must not replace what the quicker one wrote."""
    path, column = tmp_path / "one.mcap", Stream("contact", (Column("time_s", "s", 1, ""),))

    def slow_columns():
        write_session(path, [(column, {"time_s": [1.0]})], SessionMetadata())
        yield Event(0.0, "remark", "written second")

    with pytest.raises(SessionError, match="already exists"):
        write_session(path, [(column, {"time_s": [2.0]})], SessionMetadata(), slow_columns())
    assert list(Session.open(path).samples("contact")["time_s"]) == [1.0]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", NASTY)
def test_any_name_is_shown_in_one_line_and_typed_as_one_word(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    path.touch()
    echoed = subprocess.run(["bash", "-c", f"ls -d {shell_path(path)}"], capture_output=True, check=True)
    assert os.fsdecode(echoed.stdout) in {f"{name}\n", f"./{name}\n"}
    written = io.StringIO()
    console.Console(file=written, highlight=False, width=200).print(display_path(path))
    assert written.getvalue().rstrip("\n").isprintable()
    assert ("[bold]" in name) == ("[bold]" in written.getvalue())


def test_next_commands_can_be_pasted(tmp_path):
    file = tmp_path / "a [bold]b.mcap"
    said = io.StringIO()
    with redirect_stderr(said):
        console.next_steps((f"palpate info {shell_path(file)}", "what is in it"))
    assert f"info {as_shell_word(str(file))}" in said.getvalue()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_unwritable_output_is_one_plain_line(options, probed):
    command = [sys.executable, "-m", "palpate.main", "info", str(probed[0]), *options]
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, cwd=ROOT
        )
    assert result.returncode == 3
    assert result.stderr == "palpate: cannot write the output: No space left on device\n"


def test_ascii_terminal_gets_everything(session):
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "MPLCONFIGDIR": "/proc"}
    strange = session.rename(session.with_name("ü.mcap"))
    result = run_process("estimate", strange, "--estimator", "lsq", "--where", "run=0", env=environment)
    assert (result.returncode, result.stdout.isascii()) == (0, True), result.stderr
    assert r"\xfc.mcap: 1 channel" in result.stdout


def test_circular_link_is_one_output(tmp_path):
    circle = tmp_path / "circle"
    circle.symlink_to("circle")
    different_files(circle, tmp_path / "a")
    with pytest.raises(InputError, match="given twice"):
        different_files(circle, circle)


def test_results_are_not_written_through_a_link_beside_a_session(session, tmp_path):
    """Whoever sends a session may put a link there, to a folder with a report of one's own."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "report.html").write_text("mine")
    session.with_suffix("").symlink_to(mine)
    for command in ("diagnose", "inspect", "revisions"):
        assert_refused(run(command, session), "is a symbolic link to", str(mine))
    assert_refused(run("add", session, "bias", "--channel", "contact"), "is a symbolic link to", str(mine))
    assert [(path.name, path.read_text()) for path in mine.iterdir()] == [("report.html", "mine")]
    assert run("revisions", session, "--folder", mine).exit_code in {0, 2}  # a folder that is named is used
    session.with_suffix("").unlink()
    session.with_suffix("").mkdir()
    (session.with_suffix("") / "revisions").symlink_to(mine)
    assert_refused(run("add", session, "bias", "--channel", "contact"), "is a symbolic link, which is not")
    assert [path.name for path in mine.iterdir()] == ["report.html"]
