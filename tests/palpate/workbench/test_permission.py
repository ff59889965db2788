"""Workbench page before it is ready, and its permission question for a real arm."""

import asyncio
import re
import time
from base64 import b64encode
from contextlib import closing
from hashlib import sha256
from http import HTTPStatus
from http.client import HTTPConnection
from socket import create_connection
from types import SimpleNamespace

import pytest
from nicegui import Client, core, ui
from nicegui.page import page

from palpate.robot_io.errors import InputError
from palpate.workbench import layout
from palpate.workbench.layout import _ask_permission
from palpate.workbench.startup import EarlyServer


def answered(capsys, typed, *, yes=True):
    """Whether the question is answered by yes where this is typed, and the number of the terminal."""

    async def ask(client):
        with client:
            return await _ask_permission(8.0, ["palpate", "probe", "--robot", "my arm.yaml"])

    async def answer():
        core.loop = asyncio.get_running_loop()
        client = Client(page(""))
        asked = asyncio.create_task(ask(client))
        await asyncio.sleep(0)
        code = re.search(r"type (\d{6}) on the page", capsys.readouterr().err)[1]
        elements = list(client.elements.values())
        said = str([one._to_dict() for one in elements])
        assert "press with 8 N" in said
        assert "palpate probe --robot 'my arm.yaml'" in said
        assert code not in said
        next(one for one in elements if isinstance(one, ui.input)).value = typed(code)
        next(one for one in elements if isinstance(one, ui.dialog)).submit(yes)
        return await asked, code

    return asyncio.run(answer())


def test_displayed_number_grants_permission_and_changes_each_time(capsys):
    given = [answered(capsys, lambda code: f" {code}\n") for _ in range(5)]
    assert all(permitted for permitted, _ in given)
    assert len({code for _, code in given}) > 1


@pytest.mark.parametrize(
    "typed",
    [lambda code: "", lambda code: None, lambda code: "yes", lambda code: f"{(int(code) + 1) % 10**6:06d}"],
)
def test_other_answers_grant_nothing(capsys, typed):
    assert not answered(capsys, typed)[0]


def test_declining_with_the_number_grants_nothing(capsys):
    assert not answered(capsys, lambda code: code, yes=False)[0]


@pytest.fixture
def early():
    with EarlyServer(0) as made:
        made.answer_with("<b>raw curves</b>")
        yield made
        made.shutdown()


def asked(early, host="127.0.0.1", path="/"):
    connection = HTTPConnection("127.0.0.1", early.port, timeout=60)
    connection.request("GET", path, headers={"Host": f"{host}:{early.port}"})
    return connection


def test_first_visitor_sees_the_measurement(early):
    answer = asked(early).getresponse()
    assert answer.status == HTTPStatus.OK
    assert "<b>raw curves</b>" in answer.read().decode()


def test_late_requests_wait_for_the_main_server(early):
    asked(early).getresponse().read()
    later = asked(early)
    early.socket.settimeout(20.0)
    time.sleep(0.05)  # in which nobody answers
    with closing(early.release_socket().accept()[0]) as taken:
        assert taken.recv(1000).startswith(b"GET / HTTP/1.1")
        taken.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")
    assert later.getresponse().status == HTTPStatus.NO_CONTENT


def test_page_with_a_foreign_host_name_is_refused(early):
    assert asked(early, "evil.example").getresponse().status == HTTPStatus.BAD_REQUEST
    assert asked(early).getresponse().status == HTTPStatus.OK


def test_reconnecting_page_leaves_the_answer_to_the_visitor(early):
    assert asked(early, path="/_nicegui_ws/socket.io").getresponse().status == HTTPStatus.SERVICE_UNAVAILABLE
    assert "<b>raw curves</b>" in asked(early).getresponse().read().decode()


def test_pending_requests_wait_for_the_server():
    with EarlyServer(0) as silent:
        waiting = [create_connection(("127.0.0.1", silent.port), timeout=5) for _ in range(50)]
        taken = silent.release_socket()
        for one in waiting:
            taken.accept()[0].close()
            one.close()


def test_first_answer_runs_only_its_own_script_and_is_framed_by_none(early):
    reply = asked(early).getresponse()
    script = re.search("<script>(.*)</script>", reply.read().decode())[1]
    policy = reply.headers["Content-Security-Policy"]
    assert b64encode(sha256(script.encode()).digest()).decode() in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe-inline" not in policy.partition("script-src")[2]


@pytest.mark.parametrize("port", [-5, 99_999_999])
def test_invalid_port_is_refused(port):
    with pytest.raises(InputError, match=f"--port {port}: .*choose another port"):
        EarlyServer(port)


@pytest.mark.parametrize(
    ("source", "is_open", "permits", "designed", "expected"),
    [
        ("simulated", True, False, True, [["--seed", "3"]]),
        ("simulated", False, False, True, []),
        ("simulated", True, False, None, []),
        ("simulated", True, False, InputError("no arm"), []),
        ("robot", True, True, True, [["3", "--yes"]]),
        ("robot", True, False, True, []),
        ("robot", False, True, True, []),
    ],
)
def test_motion_is_requested_only_on_an_open_page_and_with_permission(
    monkeypatch, tmp_path, source, is_open, permits, designed, expected
):
    """The experiment is designed in the background; whoever pressed the button may be gone by then."""
    probed, asked_for, said, works = [], [], [], {}

    async def probe(home, arguments, place, *, join):
        assert join
        probed.append(arguments)

    async def ask(force_n, arguments):
        asked_for.append((force_n, arguments[:2]))
        return permits

    def design(diagnoses):
        if isinstance(designed, Exception):
            raise designed
        return designed and SimpleNamespace(proposal=None, plan=SimpleNamespace(force_limit_n=8.0))

    session = SimpleNamespace(metadata=SimpleNamespace(extra={"source": source}))
    study = SimpleNamespace(
        source=SimpleNamespace(session=session), folder=tmp_path / "press-palpate", next_probe=design
    )
    state = SimpleNamespace(study=study, diagnosis=SimpleNamespace(next_experiment=object()))
    monkeypatch.setattr(layout, "same_world", lambda _: "--seed 3")
    monkeypatch.setattr(layout, "plan_text", lambda *_: "hold_s: 0.1\n")
    monkeypatch.setattr(layout, "_probe", probe)
    monkeypatch.setattr(layout, "_ask_permission", ask)
    monkeypatch.setattr(layout, "_once", lambda text, work: works.setdefault(text, work) and ui.button(text))
    monkeypatch.setattr(ui, "notify", lambda text, **_: said.append(text))
    monkeypatch.setattr(Client, "has_socket_connection", property(lambda _: is_open))

    async def press():
        core.loop = asyncio.get_running_loop()
        with Client(page("")):
            layout._next_step(None, state)
            where = "simulated arm" if source == "simulated" else "robot"
            await works[f"Run it on the {where}"]()

    asyncio.run(press())
    assert [arguments[-2:] for arguments in probed] == expected
    assert asked_for == ([(8.0, ["palpate", "probe"])] if source == "robot" and is_open else [])
    assert ("Resolve: probe until one explanation is left" in works) is (source == "simulated")
    assert len(said) == (designed is not True)
    file = study.folder / layout._NEXT
    assert file.exists() is (designed is True)
    assert all(str(file) in arguments for arguments in probed)
