"""`palpate workbench`: refusals in one line, and local access only."""

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

WATCHED = """
import os, sys
from palpate.main import main
sys.addaudithook(lambda event, _: event == "gc.get_objects" and os.write(1, b"all objects held\\n"))
main()
"""


@contextmanager
def started(folder):
    """The server; gives its port. It never holds all objects of the program, which fails in other threads."""
    command = [sys.executable, "-c", WATCHED, "workbench", str(folder), "--port", "0", "--no-browser"]
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
        assert "all objects held" not in process.communicate()[0]


def answer(port, path="/", host="127.0.0.1", **headers):
    """What the server answers; header_name sets header-name."""
    connection = HTTPConnection("127.0.0.1", port)
    given = {name.replace("_", "-"): value.format(port=port) for name, value in headers.items()}
    connection.request("GET", path, headers={"Host": f"{host}:{port}", **given})
    return connection.getresponse()


def status(port, host):
    return answer(port, host=host).status


def socket_status(port, **headers):
    """What a websocket's first request is answered, on which everything else goes."""
    asked = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13"}
    path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    return answer(port, path, **asked, Sec_WebSocket_Key="dGhlIHNhbXBsZSBub25jZQ==", **headers).status


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
        (["there.csv", "--held-out", "7"], "there is no run 7. Available: 0, 1, 2, 3"),
        (["there.csv", "--model", "kelvin"], "no model is called 'kelvin'; did you mean 'kelvin_voigt'?"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_presses(tmp_path / "there.csv")
    assert_refused(run("workbench", *arguments, "--no-browser"), said)


def test_port_in_use_is_named(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert_refused(run("workbench", tmp_path, "--port", port, "--no-browser"), str(port), "0 for any")


HOSTS = {"127.0.0.1": HTTPStatus.OK, "localhost": HTTPStatus.OK, "evil.example": HTTPStatus.BAD_REQUEST}


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A server's port, and what it answered at first to each name as host."""
    with started(tmp_path_factory.mktemp("empty")) as port:
        yield port, {host: status(port, host) for host in HOSTS}


@pytest.fixture(scope="module")
def port(begun):
    """Of a server that has taken over from the first answer."""
    while "nicegui" not in answer(begun[0]).read().decode():
        time.sleep(0.1)
    return begun[0]


def test_page_with_a_foreign_host_name_is_refused(begun, port):
    """DNS rebinding: the browser asks this machine, with the other site's name as host."""
    assert begun[1] == {host: status(port, host) for host in HOSTS} == HOSTS


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"Origin": "http://127.0.0.1:{port}"}, HTTPStatus.SWITCHING_PROTOCOLS),
        ({"Origin": "http://localhost:{port}"}, HTTPStatus.SWITCHING_PROTOCOLS),
        ({"Origin": "http://evil.example"}, HTTPStatus.FORBIDDEN),
        ({"Origin": "http://127.0.0.1:1"}, HTTPStatus.FORBIDDEN),  # another program's page on this machine
        ({"Origin": "https://127.0.0.1:{port}"}, HTTPStatus.FORBIDDEN),
        ({"Origin": "http://127.0.0.1:{port}0"}, HTTPStatus.FORBIDDEN),
        ({"Origin": "null"}, HTTPStatus.FORBIDDEN),  # a page in a sandbox, or a file
        ({}, HTTPStatus.FORBIDDEN),
    ],
)
def test_foreign_page_opens_no_socket(port, headers, expected):
    assert socket_status(port, **headers) == expected


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"Sec_Fetch_Site": "none", "Sec_Fetch_Mode": "navigate"}, HTTPStatus.OK),
        ({"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}, HTTPStatus.OK),  # a link
        ({"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"}, HTTPStatus.FORBIDDEN),
        ({"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"}, HTTPStatus.FORBIDDEN),
        ({"Origin": "http://evil.example"}, HTTPStatus.FORBIDDEN),
    ],
)
def test_foreign_page_loads_nothing(port, headers, expected):
    assert answer(port, **headers).status == expected
    assert answer(port, "/report/guessed").status == HTTPStatus.NOT_FOUND


def policy_of(headers):
    """The directives of the Content-Security-Policy."""
    pairs = (one.split() for one in headers["Content-Security-Policy"].split(";"))
    return {name: values for name, *values in pairs}


def test_page_runs_only_its_own_scripts_and_is_framed_by_none(port):
    reply = answer(port)
    page, policy = reply.read().decode(), policy_of(reply.headers)
    assert policy["frame-ancestors"] == policy["default-src"] == policy["base-uri"] == ["'none'"]
    assert policy["connect-src"] == ["'self'", f"ws://127.0.0.1:{port}", f"ws://localhost:{port}"]
    assert reply.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    own, nonce, *_ = policy["script-src"]
    assert own == "'self'"
    scripts = re.findall("<script[^>]*>", page)
    assert len(scripts) > 5
    assert all('nonce="{}"'.format(nonce[len("'nonce-") : -1]) in one for one in scripts)
    assert policy_of(answer(port).headers)["script-src"][1] != nonce  # of each answer
