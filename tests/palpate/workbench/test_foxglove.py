"""Data that a Foxglove WebSocket client receives during a probing."""

import errno
import json
import socket
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from palpate.control.loop.tick_record import tick_stream
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Samples
from palpate.workbench.live import TOPIC, FoxgloveFeed

client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
WAIT_S = 60


def pressing(count):
    """Ticks of an arm of two joints that presses 1 mm deep into 500 N/m; no estimate in the first one."""
    stream = tick_stream(2)
    records = np.zeros(
        count, dtype=[(c.name, c.dtype, (c.width,) if c.width > 1 else ()) for c in stream.columns]
    )
    records["time_s"] = 0.001 * np.arange(count)
    records["force_n"], records["stiffness_n_m"] = 0.6, np.where(records["time_s"] > 0.0, 500.0, np.nan)
    records["press_direction_world"] = (0.0, 0.0, -1.0)
    records["tip_position_world_m"] = (0.3, 0.0, -0.001)
    records["torque_measured_nm"] = (1.5, -0.5)
    return Samples.from_records(stream, records)


@pytest.fixture
def feed():
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    made = FoxgloveFeed("127.0.0.1", 0)
    yield made
    made.close()


def received(viewer):
    """Time [s] and content of the next message."""
    while isinstance(data := viewer.recv(timeout=WAIT_S), str):
        pass
    opcode, _, time_ns = struct.unpack_from("<BIQ", data)
    assert opcode == 1
    return time_ns / 1e9, json.loads(data[13:])


def test_client_gets_the_schema_and_each_tick_once(feed):
    address = f"ws://127.0.0.1:{feed.port}"
    with client.connect(address, subprotocols=["foxglove.sdk.v1"], open_timeout=WAIT_S) as viewer:
        said = {}
        while "advertise" not in said:
            text = json.loads(viewer.recv(timeout=WAIT_S))
            said[text["op"]] = text
        (channel,) = said["advertise"]["channels"]
        assert channel["topic"] == TOPIC
        assert {"force_n", "torque_nm", "stiffness_n_m", "residual_n"} <= set(
            json.loads(channel["schema"])["properties"]
        )
        subscription = {"id": 1, "channelId": channel["id"]}
        viewer.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
        until_s = time.monotonic() + WAIT_S
        while not feed.is_watched:
            assert time.monotonic() < until_s
            time.sleep(0.01)
        feed.send(Path("a.mcap"), pressing(2))
        feed.send(Path("a.mcap"), pressing(3))
        feed.send(Path("b.mcap"), pressing(1))
        first, second, third, other = (received(viewer) for _ in range(4))
    assert first == (0.0, {"force_n": 0.6, "damping_n_s_m": 0.0, "torque_nm": [1.5, -0.5]})
    assert second[0] == 0.001
    assert second[1]["stiffness_n_m"] == 500.0
    assert second[1]["residual_n"] == pytest.approx(0.1)
    assert (third[0], other[0]) == (0.002, 0.0)


class SlowToCompare(np.ndarray):
    """Gives another thread time to come between what was read and what is kept."""

    def max(self, *args, **options):
        time.sleep(0.05)
        return super().max(*args, **options)


class SlowTicks:
    """Ticks whose columns are such."""

    def __init__(self, ticks):
        self._ticks, self.vector = ticks, ticks.vector

    def __getitem__(self, name):
        return self._ticks[name].view(SlowToCompare)


class Subscribed:
    """A channel that somebody has subscribed to."""

    def __init__(self):
        self.times_ns = []

    def has_sinks(self):
        return True

    def log(self, message, log_time):
        self.times_ns.append(log_time)

    def close(self):
        pass


def test_pages_that_follow_one_session_send_each_tick_once(feed):
    feed._channel.close()
    feed._channel, ticks, both = Subscribed(), pressing(50), Barrier(2)

    def follow():
        both.wait(WAIT_S)
        feed.send(Path("a.mcap"), SlowTicks(ticks))

    with ThreadPoolExecutor(2) as pages:
        for page in [pages.submit(follow) for _ in range(2)]:
            page.result()
    assert len(feed._channel.times_ns) == 50


def test_feed_without_a_session_sends_nothing(feed):
    feed.send(Path("a.mcap"), None)


def reached(port):
    """What a connection to a port ends with, as an error of the system."""
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port))


def test_feed_ends_with_the_page(feed):
    feed.close()
    until_s = time.monotonic() + WAIT_S
    # the listening socket closes in a thread of the server's: until then, a connection is made or reset
    while reached(feed.port) != errno.ECONNREFUSED:
        assert time.monotonic() < until_s
        time.sleep(0.01)


def test_port_in_use_is_named(feed):
    with pytest.raises(InputError, match=f"--foxglove {feed.port}: in use, or not permitted; choose another"):
        FoxgloveFeed("127.0.0.1", feed.port)
