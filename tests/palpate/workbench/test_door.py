"""What is answered at the page's address before the page can be served."""

from contextlib import closing
from http import HTTPStatus
from http.client import HTTPConnection

import pytest

from palpate.workbench.door import Door


@pytest.fixture
def door():
    with Door("127.0.0.1", 0) as made:
        made.show("<b>raw curves</b>")
        yield made
        made.shutdown()


def asked(door, host="127.0.0.1"):
    connection = HTTPConnection("127.0.0.1", door.port, timeout=60)
    connection.request("GET", "/", headers={"Host": f"{host}:{door.port}"})
    return connection


def test_the_first_visitor_sees_what_was_measured(door):
    answer = asked(door).getresponse()
    assert answer.status == HTTPStatus.OK
    assert "<b>raw curves</b>" in answer.read().decode()


def test_whoever_comes_later_is_kept_for_the_server_that_takes_over(door):
    asked(door).getresponse().read()
    later = asked(door)
    with closing(door.handed_over().accept()[0]) as taken:
        assert taken.recv(1000).startswith(b"GET / HTTP/1.1")
        taken.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")
    assert later.getresponse().status == HTTPStatus.NO_CONTENT


def test_a_page_of_another_name_that_points_here_is_refused(door):
    assert asked(door, "evil.example").getresponse().status == HTTPStatus.BAD_REQUEST
    assert asked(door).getresponse().status == HTTPStatus.OK
