"""The command: bad input gives one line, and it listens on this machine alone."""

import re
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from http import HTTPStatus
from http.client import HTTPConnection
from pathlib import Path

import pytest

from tests.palpate.cli import assert_refused, run
from tests.palpate.presses import write_presses


@contextmanager
def started(folder):
    """The server; gives its port."""
    command = [sys.executable, "-m", "palpate.main", "workbench", str(folder), "--port", "0", "--no-browser"]
    paths = {"PYTHONPATH": str(Path(__file__).parents[3]), "PATH": "/usr/bin:/bin"}
    process = subprocess.Popen(command, env=paths, stdout=subprocess.PIPE, text=True)
    try:
        port = int(re.search(r"127\.0\.0\.1:(\d+)", process.stdout.readline())[1])
        while socket.socket().connect_ex(("127.0.0.1", port)):
            assert process.poll() is None
            time.sleep(0.1)
        yield port
    finally:
        process.kill()
        process.wait()


def status(port, host):
    connection = HTTPConnection("127.0.0.1", port)
    connection.request("GET", "/", headers={"Host": f"{host}:{port}"})
    return connection.getresponse().status


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["no.csv"], "no.csv"),
        (["press.csv", "--riddle"], "leave out the file"),
        (["--port", "99999"], "65535"),
        (["--port", "8123", "--foxglove", "8123"], "--port 8123 and --foxglove 8123"),
        (["there.csv", "--urdf", "no.urdf"], "URDF no.urdf: no such file"),
        (["there.csv", "--effect", "no.py:Mine"], "effect no.py: no such file"),
        (["there.csv", "--held-out", "x"], "--held-out x: give run numbers"),
        (["there.csv", "--held-out", "7"], "there is no run 7. There are: 0, 1, 2, 3"),
        (["there.csv", "--model", "kelvin"], "no model is called 'kelvin'; did you mean 'kelvin_voigt'?"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_presses(tmp_path / "there.csv")
    assert_refused(run("workbench", *arguments, "--no-browser"), said)


def test_a_port_that_somebody_has_is_named(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert_refused(run("workbench", tmp_path, "--port", port, "--no-browser"), str(port), "0 for any")


def test_a_page_of_another_name_that_points_here_is_refused(tmp_path):
    """DNS rebinding: the browser asks this machine, with the other site's name as host."""
    with started(tmp_path) as port:
        assert status(port, "127.0.0.1") == HTTPStatus.OK
        assert status(port, "localhost") == HTTPStatus.OK
        assert status(port, "evil.example") == HTTPStatus.BAD_REQUEST
