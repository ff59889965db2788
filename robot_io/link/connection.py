"""Line between leader and follower over eclipse-zenoh, by default between peers on this machine.

Frames are sent once, never repeated by the program: each message holds the whole state of its sender. A
callback of zenoh's own thread only stores bytes; `receive` decodes them. For tests, outgoing frames can be
delayed, jittered and lost with a fixed seed.
"""

import heapq
import json
import re
import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.link.frame import (
    CHECKSUM,
    MOST_BYTES,
    Frame,
    FrameError,
    LastReceived,
    check_secret,
    decode,
    encode,
    load_seal,
)
from palpate.robot_io.link.messages import Message

if TYPE_CHECKING:
    import zenoh
else:
    zenoh = LazyModule("zenoh")


@dataclass(frozen=True)
class Impairment:
    """Impairment of the network in one direction."""

    delay_s: float = 0.0  # mean delay [s]
    jitter_s: float = 0.0  # standard deviation of the delay, which is never below 0 [s]
    loss: float = 0.0  # share of frames that are lost
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0.0 <= self.delay_s <= 60.0 and 0.0 <= self.jitter_s <= 60.0):
            raise InputError(f"delay {self.delay_s} s, jitter {self.jitter_s} s: each must be 0 to 60 s")
        if not 0.0 <= self.loss < 1.0:
            raise InputError(f"loss {self.loss}: must be at least 0 and below 1")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"seed {self.seed}: must be at least 0 and below 2^63")


class NetworkEmulator:
    """Delays and loses frames; frames may overtake each other."""

    def __init__(self, impairment: Impairment) -> None:
        self._impairment, self._generator = impairment, np.random.default_rng(impairment.seed)
        self._held: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, data: bytes, now_s: float) -> None:
        """Add a frame that is sent now.

        Args:
            data: the frame.
            now_s: time [s].
        """
        self._count += 1
        impairment = self._impairment
        if self._generator.random() >= impairment.loss:
            delay_s = max(0.0, self._generator.normal(impairment.delay_s, impairment.jitter_s))
            heapq.heappush(self._held, (now_s + delay_s, self._count, data))

    def due(self, now_s: float) -> list[bytes]:
        """Return frames that have arrived, in the order of their arrival.

        Args:
            now_s: time [s].
        """
        arrived = []
        while self._held and self._held[0][0] <= now_s:
            arrived.append(heapq.heappop(self._held)[2])
        return arrived


Role = Literal["leader", "follower"]
_TLS, _LISTEN, _MULTICAST = "transport/link/tls", "listen/endpoints", "scouting/multicast/enabled"
_OTHER_ROLE: dict[Role, Role] = {"leader": "follower", "follower": "leader"}
_WAITING = 512  # received frames that are kept until `receive`; then the oldest are dropped
_LOOPBACK = "tcp/127.0.0.1"
_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
_PLACE = re.compile(r"\s+at /\S+\.rs:\d+\.?")
_MESSAGE = re.compile(r'Message \{ msg: "(.*)", location: .*?line: (\d+), column: (\d+)')
_SYNTAX = re.compile(r"--> (\d+):(\d+) .*= (.*)")
_MOST_SAID = 200  # characters of a message of zenoh


@dataclass(frozen=True)
class LinkSettings:
    """Settings by which the two sides find each other.

    Without a file both are peers on this machine's loopback, the follower listening. A file is zenoh's own
    configuration (JSON5), which defines everything: endpoints, router, certificates, access.
    """

    name: str = "arm"  # name of the pair, equal on both sides
    port: int = 7447
    config: Path | None = None
    key: Path | None = None  # secret key of the pair; without it any frame with a valid checksum is accepted
    impairment: Impairment | None = None  # impairment of outgoing frames, for tests

    def __post_init__(self) -> None:
        if not self.name.replace("-", "").replace("_", "").isalnum():
            raise InputError(f"link name {self.name!r}: use only letters, digits, - and _")
        if not 1024 <= self.port <= 65535:
            raise InputError(f"port {self.port}: must be 1024 to 65535")


class LinkConnection:
    """One end of the line; sends and receives frames.

    Attributes:
        sender: random number in every frame of this end.
        malformed: number of received frames that were invalid, or of another version or key.
        refused: why the newest of these was refused; empty before the first.
        is_open_here: whether any program of this machine may send targets, with neither key nor
            certificates.

    Raises:
        InputError: zenoh refuses the configuration, the endpoint cannot be opened, or the key is invalid; or
            other machines could reach a follower with neither key nor certificates.
    """

    def __init__(self, role: Role, settings: LinkSettings, clock: Clock) -> None:
        self.sender = secrets.randbits(62)
        self.malformed, self.refused = 0, ""
        self.role, self._settings, self._clock = role, settings, clock
        self._sequence, self._heard = 0, LastReceived()
        self._waiting: deque[tuple[float, bytes]] = deque(maxlen=_WAITING)
        self._network = NetworkEmulator(settings.impairment) if settings.impairment else None
        config = _config(role, settings)
        is_mutual = bool(json.loads(config.get_json(_TLS))["enable_mtls"])  # both sides need a certificate
        is_certified = is_mutual and all(e.startswith(("tls/", "quic/")) for e in _endpoints(config))
        self.is_open_here = role == "follower" and settings.key is None and not is_certified
        if self.is_open_here:  # without zenoh's default listeners, other machines must not reach it
            if config.get_json(_LISTEN) == zenoh.Config().get_json(_LISTEN):
                config.insert_json5(_LISTEN, json.dumps([f"{_LOOPBACK}:{settings.port}"]))
            open_to = [endpoint for endpoint in _endpoints(config) if not _is_local(endpoint)]
            if json.loads(config.get_json(_MULTICAST)):
                open_to.append(_MULTICAST.replace("/", "."))
            config.insert_json5(_MULTICAST, "false")
            if open_to:
                raise InputError(
                    f"{settings.config}: {open_to[0]}: anybody who connects there could move the arm. Give "
                    "--key FILE on both sides, use certificates (enable_mtls), or use only addresses of "
                    "127.0.0.1"
                )
        self._over_udp = any("udp/" in config.get_json(f"{key}/endpoints") for key in ("listen", "connect"))
        topics = [f"palpate/{settings.name}/{side}" for side in (role, _OTHER_ROLE[role])]
        own_topic, self._peer_topic = topics
        key = settings.key
        self._own_seal, self._peer_seal = (load_seal(key, topic) if key else CHECKSUM for topic in topics)
        try:
            self._session = zenoh.open(config)
            self._subscriber = self._session.declare_subscriber(self._peer_topic, self._arrived)
            self._publisher = self._session.declare_publisher(
                own_topic, congestion_control=zenoh.CongestionControl.DROP, express=True
            )
        except zenoh.ZError as error:
            where, why = settings.config or f"{_LOOPBACK}:{settings.port}", cause(error)
            hint = f"; is another {role} using it?" if "already in use" in why else ""
            raise InputError(f"link {where}: {why}{hint}") from None
        self._put: Callable[[bytes], object] = self._publisher.put

    def send(self, message: Message) -> None:
        """Send one message without waiting for the other side.

        Args:
            message: the content.
        """
        now_s = self._clock.now_s()
        data = encode(self.sender, self._sequence, now_s, self._heard, message, self._own_seal)
        self._sequence += 1
        if self._network is None:
            self._put(data)
        else:
            self._network.put(data, now_s)
        self._pump()

    def receive(self) -> list[tuple[float, Frame]]:
        """Return frames that have arrived since the last call, each with its time of arrival [s]."""
        self._pump()
        arrived = []
        # Frames that arrive meanwhile wait, because a flood would never end.
        for _ in range(len(self._waiting)):
            at_s, data = self._waiting.popleft()
            try:
                arrived.append((at_s, decode(data, self._peer_seal)))
            except FrameError as error:
                self.refuse(str(error))
        return arrived

    def resubscribe(self) -> None:
        """Repeat the subscription, because zenoh announces it only once, which may be lost over UDP."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._subscriber = self._session.declare_subscriber(self._peer_topic, self._arrived)

    def refuse(self, why: str) -> None:
        """Count received bytes that are not a valid frame or message.

        Args:
            why: reason.
        """
        self.malformed, self.refused = self.malformed + 1, why

    @property
    def advice(self) -> str:
        """Return suggestions if nothing is received from the other side."""
        shared_option = "--port" if self._settings.config is None else "a --link that reaches this side"
        advice = f"is a {_OTHER_ROLE[self.role]} running with the same --name and --key, and {shared_option}?"
        if not self._over_udp:
            return advice
        return (
            f"{advice} Over UDP, each packet lost while connecting costs 10 s "
            "(transport.unicast.open_timeout); over tcp or tls, lost packets are sent again"
        )

    def heard(self, frame: Frame, at_s: float) -> None:
        """Record the newest frame of the peer; the next frame sent refers to it.

        Args:
            frame: received frame.
            at_s: arrival time on this side's clock [s].
        """
        self._heard = LastReceived(frame.sender, frame.sent_s, at_s)

    def close(self) -> None:
        """End the session; can be called twice."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _arrived(self, sample: "zenoh.Sample") -> None:
        if len(sample.payload) > MOST_BYTES:  # not a frame, so not stored
            self.refuse(f"more than {MOST_BYTES} bytes")
            return
        self._waiting.append((self._clock.now_s(), sample.payload.to_bytes()))

    def _pump(self) -> None:
        if self._network is not None:
            for data in self._network.due(self._clock.now_s()):
                self._put(data)


def _config(role: Role, settings: LinkSettings) -> "zenoh.Config":
    """Read zenoh's configuration, or make that of a pair on this machine."""
    if settings.config is not None:
        try:
            config = zenoh.Config.from_file(str(settings.config))
        except zenoh.ZError as error:
            raise InputError(f"{settings.config}: is not a zenoh configuration: {cause(error)}") from None
        # Check that certificates and keys exist; zenoh does not report missing ones.
        for name, file in json.loads(config.get_json(_TLS)).items():
            if name.endswith(("_certificate", "_private_key")) and file:
                where = f"{settings.config}: transport.link.tls.{name}"
                if not Path(file).is_file():
                    raise InputError(f"{where}: no file '{file}' (relative to the current folder)")
                if name.endswith("_private_key"):
                    check_secret(Path(file), where)
        return config
    endpoints = [f"{_LOOPBACK}:{settings.port}"]
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        _MULTICAST: False,
        _LISTEN: endpoints if role == "follower" else [],
        "connect/endpoints": endpoints if role == "leader" else [],
        "connect/retry": _RETRY,
        "connect/exit_on_failure": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _endpoints(config: "zenoh.Config") -> list[str]:
    """List all endpoints on which zenoh listens, or to which it connects."""
    found_endpoints: list[str] = []
    for direction in ("listen", "connect"):
        endpoints = json.loads(config.get_json(f"{direction}/endpoints"))
        if isinstance(endpoints, dict):  # by the mode of this side
            endpoints = chain.from_iterable(endpoints.values())
        found_endpoints += map(str, endpoints)
    return found_endpoints


def _is_local(endpoint: str) -> bool:
    """Return whether an endpoint, such as tcp/127.0.0.1:7447, is reached from this machine alone."""
    protocol, _, address = endpoint.partition("/")
    host = re.split("[?#]", address)[0].rpartition(":")[0].strip("[]")
    try:
        return protocol.startswith("unix") or host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def cause(error: Exception) -> str:
    """Extract the cause of a `zenoh.ZError` for the user.

    Args:
        error: the error, whose text names places in zenoh's source.

    Returns:
        One line, without these places and cut to a bounded length.
    """
    text = _PLACE.sub("", one_line(error))
    if match := _MESSAGE.search(text):
        what, line, column = match.groups()
    elif match := _SYNTAX.search(text):
        line, column, what = match.groups()
    else:
        return text[:_MOST_SAID]
    return f"line {line}, column {column}: {what}"[:_MOST_SAID]
