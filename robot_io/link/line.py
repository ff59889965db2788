"""The line between leader and follower: eclipse-zenoh, peers on this machine unless a file says otherwise.

Frames are sent as they are, never repeated by the program: each message says the whole state of its sender.
A callback of zenoh's own thread only puts bytes aside; whoever calls `receive` decodes them.
"""

import json
import re
import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Literal, Self

from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.link.frame import MOST_BYTES, Frame, FrameError, Heard, decode, encode
from robot_io.link.impairment import BadNetwork, Impairment
from robot_io.link.messages import Message
from robot_io.link.seal import CHECKSUM, check_secret, load_seal

Role = Literal["leader", "follower"]
_TLS, _LISTEN, _MULTICAST = "transport/link/tls", "listen/endpoints", "scouting/multicast/enabled"
_OTHER: dict[Role, Role] = {"leader": "follower", "follower": "leader"}
_WAITING = 512  # frames that nobody has asked for yet; what comes beyond drives the oldest out
_LOOPBACK = "tcp/127.0.0.1"
_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
_PLACE = re.compile(r"\s+at /\S+\.rs:\d+\.?")
_MESSAGE = re.compile(r'Message \{ msg: "(.*)", location: .*?line: (\d+), column: (\d+)')
_SYNTAX = re.compile(r"--> (\d+):(\d+) .*= (.*)")
_MOST_SAID = 200  # characters of what zenoh says


@dataclass(frozen=True)
class LineSettings:
    """How the two find each other.

    Without a file both are peers on this machine's loopback, the follower listening; with one it is
    zenoh's own configuration (JSON5) that says everything: endpoints, router, certificates, access.
    """

    name: str = "arm"  # of the pair: both sides must give the same
    port: int = 7447
    config: Path | None = None
    key: Path | None = None  # a secret of the pair; without it any frame with a fitting checksum is taken
    impairment: Impairment | None = None  # of what this side sends, for trials

    def __post_init__(self) -> None:
        if not self.name.replace("-", "").replace("_", "").isalnum():
            raise InputError(f"link name {self.name!r}: letters, digits, - and _ only")
        if not 1024 <= self.port <= 65535:
            raise InputError(f"port {self.port}: 1024 to 65535")


class Line:
    """One end of the line; sends and receives frames.

    Attributes:
        role: of this side.
        sender: random number in every frame of this end.
        malformed: frames that were no frames, or of another version or key.
        refused: why the newest of these was none; empty before the first.
        is_open_here: whether any program of this machine may say where to probe, with neither key nor
            certificates.

    Raises:
        InputError: zenoh refuses the configuration, the endpoint cannot be opened, or the key is none; or a
            follower with neither key nor certificates would be reached from other machines.
    """

    def __init__(self, role: Role, settings: LineSettings, clock: Clock) -> None:
        import zenoh  # noqa: PLC0415, nobody else should wait for it

        self.sender = secrets.randbits(62)
        self.malformed, self.refused = 0, ""
        self.role, self._settings, self._clock = role, settings, clock
        self._sequence, self._heard = 0, Heard()
        self._waiting: deque[tuple[float, bytes]] = deque(maxlen=_WAITING)
        self._network = BadNetwork(settings.impairment) if settings.impairment else None
        config = _config(zenoh, role, settings)
        self.is_open_here = role == "follower" and settings.key is None and not _certified(config)
        if self.is_open_here:
            _keep_to_this_machine(zenoh, config, settings)
        self._over_udp = any("udp/" in config.get_json(f"{way}/endpoints") for way in ("listen", "connect"))
        said, heard = (f"palpate/{settings.name}/{side}" for side in (role, _OTHER[role]))
        secret = settings.key
        self._mine, self._theirs = (load_seal(secret, one) if secret else CHECKSUM for one in (said, heard))
        try:
            self._session = zenoh.open(config)
            self._subscribed = heard
            self._subscriber = self._session.declare_subscriber(self._subscribed, self._arrived)
            self._publisher = self._session.declare_publisher(
                said, congestion_control=zenoh.CongestionControl.DROP, express=True
            )
        except zenoh.ZError as error:
            where, why = settings.config or f"{_LOOPBACK}:{settings.port}", cause(error)
            hint = f"; is it taken by another {role}?" if "already in use" in why else ""
            raise InputError(f"link {where}: {why}{hint}") from None
        self._put: Callable[[bytes], object] = self._publisher.put

    def send(self, message: Message) -> None:
        """Send one message with everything a frame says; does not wait for the other side."""
        now_s = self._clock.now_s()
        data = encode(self.sender, self._sequence, now_s, self._heard, message, self._mine)
        self._sequence += 1
        if self._network is None:
            self._put(data)
        else:
            self._network.put(data, now_s)
        self._pump()

    def receive(self) -> list[tuple[float, Frame]]:
        """Frames that have arrived since the last call, each with its time of arrival [s]."""
        self._pump()
        arrived = []
        for _ in range(len(self._waiting)):  # not those that come meanwhile: a flood would hold this for good
            at_s, data = self._waiting.popleft()
            try:
                arrived.append((at_s, decode(data, self._theirs)))
            except FrameError as error:
                self.refuse(str(error))
        return arrived

    def resubscribe(self) -> None:
        """Tell the other side again that this one listens: zenoh says it once, which over UDP may be lost."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._subscriber = self._session.declare_subscriber(self._subscribed, self._arrived)

    def refuse(self, why: str) -> None:
        """Count what came and is no frame, or no message."""
        self.malformed, self.refused = self.malformed + 1, why

    @property
    def advice(self) -> str:
        """What to look at where the other side is not heard."""
        same = "--port" if self._settings.config is None else "a --link that meets this one"
        words = f"does a {_OTHER[self.role]} run with the same --name and --key, and {same}?"
        if not self._over_udp:
            return words
        return (
            f"{words} Over UDP each packet that is lost on connecting costs a try of 10 s "
            "(transport.unicast.open_timeout): tcp and tls repeat it"
        )

    def heard(self, frame: Frame, at_s: float) -> None:
        """Take a frame that arrived at `at_s` [s] as the newest of the peer; the next one sent says so."""
        self._heard = Heard(frame.sender, frame.sent_s, at_s)

    def close(self) -> None:
        """End the session; can be called twice."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _arrived(self, sample: Any) -> None:  # noqa: ANN401, zenoh's own
        if len(sample.payload) > MOST_BYTES:  # no frame, and not to be kept in memory until someone asks
            self.refuse(f"more than {MOST_BYTES} bytes")
            return
        self._waiting.append((self._clock.now_s(), sample.payload.to_bytes()))

    def _pump(self) -> None:
        if self._network is not None:
            for data in self._network.due(self._clock.now_s()):
                self._put(data)


def _config(zenoh: Any, role: Role, settings: LineSettings) -> Any:  # noqa: ANN401
    if settings.config is not None:
        try:
            config = zenoh.Config.from_file(str(settings.config))
        except zenoh.ZError as error:
            raise InputError(f"{settings.config}: is no zenoh configuration: {cause(error)}") from None
        _check_files(config, settings.config)
        return config
    endpoint = f"{_LOOPBACK}:{settings.port}"
    way = "listen" if role == "follower" else "connect"
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5(_MULTICAST, "false")
    config.insert_json5(_LISTEN, json.dumps([endpoint] if way == "listen" else []))
    config.insert_json5("connect/endpoints", json.dumps([endpoint] if way == "connect" else []))
    config.insert_json5("connect/retry", json.dumps(_RETRY))
    config.insert_json5("connect/exit_on_failure", "false")
    return config


def _check_files(config: Any, path: Path) -> None:  # noqa: ANN401, zenoh's own
    """Of certificates and keys; zenoh says nothing of those that it cannot connect with."""
    tls = json.loads(config.get_json(_TLS))
    for name, file in tls.items():
        if name.endswith(("_certificate", "_private_key")) and file:
            where = f"{path}: transport.link.tls.{name}"
            if not Path(file).is_file():
                raise InputError(f"{where}: no file '{file}' (from where you are now)")
            if name.endswith("_private_key"):
                check_secret(Path(file), where)


def _certified(config: Any) -> bool:  # noqa: ANN401, zenoh's own
    """Whether nobody is heard without a certificate."""
    endpoints = [*_endpoints(config, "listen"), *_endpoints(config, "connect")]
    mutual = json.loads(config.get_json(_TLS))["enable_mtls"]
    return bool(mutual) and all(one.startswith(("tls/", "quic/")) for one in endpoints)


def _keep_to_this_machine(zenoh: Any, config: Any, settings: LineSettings) -> None:  # noqa: ANN401
    """Close what zenoh opens by default, and refuse what leads to other machines.

    InputError: an endpoint does, or the search for peers in the network is switched on.
    """
    if config.get_json(_LISTEN) == zenoh.Config().get_json(_LISTEN):
        config.insert_json5(_LISTEN, json.dumps([f"{_LOOPBACK}:{settings.port}"]))
    open_to = [one for way in ("listen", "connect") for one in _endpoints(config, way) if not _is_local(one)]
    if json.loads(config.get_json(_MULTICAST)):
        open_to.append(_MULTICAST.replace("/", "."))
    config.insert_json5(_MULTICAST, "false")
    if open_to:
        raise InputError(
            f"{settings.config}: {open_to[0]}: whoever is there could say where the arm presses. Give --key "
            "FILE on both sides, or certificates (enable_mtls), or stay on 127.0.0.1"
        )


def _endpoints(config: Any, way: str) -> list[str]:  # noqa: ANN401, zenoh's own
    found = json.loads(config.get_json(f"{way}/endpoints"))
    if isinstance(found, dict):  # by the mode of this side
        found = [one for each in found.values() for one in each]
    return [str(one) for one in found]


def _is_local(endpoint: str) -> bool:
    """Whether an endpoint, such as tcp/127.0.0.1:7447, is reached from this machine alone."""
    protocol, _, address = endpoint.partition("/")
    host = re.split("[?#]", address)[0].rpartition(":")[0].strip("[]")
    try:
        return protocol.startswith("unix") or host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def cause(error: Exception) -> str:
    """The cause of a `zenoh.ZError`, for a person."""
    text = _PLACE.sub("", " ".join(str(error).split()))
    if found := _MESSAGE.search(text):
        what, line, column = found.groups()
    elif found := _SYNTAX.search(text):
        line, column, what = found.groups()
    else:
        return text[:_MOST_SAID]
    return f"line {line}, column {column}: {what}"[:_MOST_SAID]
