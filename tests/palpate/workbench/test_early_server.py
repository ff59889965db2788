"""What is answered at the page's address before the page can be served."""

import re
from base64 import b64encode
from contextlib import closing
from hashlib import sha256
from http import HTTPStatus
from http.client import HTTPConnection
from socket import create_connection

import pytest

from palpate.workbench.startup import EarlyServer


@pytest.fixture
def early():
    with EarlyServer("127.0.0.1", 0) as made:
        made.answer_with("<b>raw curves</b>")
        yield made
        made.shutdown()


def asked(early, host="127.0.0.1", path="/"):
    connection = HTTPConnection("127.0.0.1", early.port, timeout=60)
    connection.request("GET", path, headers={"Host": f"{host}:{early.port}"})
    return connection


def test_the_first_visitor_sees_what_was_measured(early):
    answer = asked(early).getresponse()
    assert answer.status == HTTPStatus.OK
    assert "<b>raw curves</b>" in answer.read().decode()


def test_whoever_comes_later_is_kept_for_the_server_that_takes_over(early):
    asked(early).getresponse().read()
    later = asked(early)
    with closing(early.release_socket().accept()[0]) as taken:
        assert taken.recv(1000).startswith(b"GET / HTTP/1.1")
        taken.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")
    assert later.getresponse().status == HTTPStatus.NO_CONTENT


def test_a_page_of_another_name_that_points_here_is_refused(early):
    assert asked(early, "evil.example").getresponse().status == HTTPStatus.BAD_REQUEST
    assert asked(early).getresponse().status == HTTPStatus.OK


def test_an_old_page_that_connects_again_leaves_the_answer_to_the_visitor(early):
    assert asked(early, path="/_nicegui_ws/socket.io").getresponse().status == HTTPStatus.SERVICE_UNAVAILABLE
    assert "<b>raw curves</b>" in asked(early).getresponse().read().decode()


def test_many_who_ask_meanwhile_are_kept():
    with EarlyServer("127.0.0.1", 0) as silent:
        waiting = [create_connection(("127.0.0.1", silent.port), timeout=5) for _ in range(50)]
        taken = silent.release_socket()
        for one in waiting:
            taken.accept()[0].close()
            one.close()


def test_the_first_answer_runs_its_own_script_alone_and_is_framed_by_none(early):
    reply = asked(early).getresponse()
    script = re.search("<script>(.*)</script>", reply.read().decode())[1]
    policy = reply.headers["Content-Security-Policy"]
    assert b64encode(sha256(script.encode()).digest()).decode() in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe-inline" not in policy.partition("script-src")[2]
