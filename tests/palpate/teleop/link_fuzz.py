"""Mutated frames for everything on both sides that the line can reach."""

import random
from collections import Counter, deque
from dataclasses import dataclass, field

from palpate.control.teleop.follower_task import TargetQueue
from palpate.control.teleop.messaging import Arrival, Messaging
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.frame import CHECKSUM, Frame, FrameCode, FrameError, LastReceived, decode, encode
from palpate.robot_io.link.messages import (
    ContactModel,
    EstimatedParameter,
    Intent,
    Message,
    ObjectEstimate,
    Report,
    Target,
)
from palpate.sim_backend.scenario import Scenario
from palpate.teleop.virtual_object import TargetStates

DOWN = (0.0, 0.0, -1.0)
MODEL = ContactModel("kelvin_voigt", ("stiffness_n_m", "damping_n_s_m"), (500.0, 20.0))
INTENT = Intent((Target(0, (0.40, 0.0, 0.05), DOWN), Target(1, (0.42, 0.0, 0.05), DOWN)), (5,), (3,), False)
REPORT = Report(
    4, 0, (0.4, 0.0, 0.05), 0.1, DOWN, 9.8, (0, 1), (1, 0), "target 7 refused: out of reach", False
)
ESTIMATE = ObjectEstimate(
    revision=3,
    target=0,
    surface_world_m=(0.4, 0.0, 0.05),
    direction_world=DOWN,
    model=(MODEL,),
    parameters=(EstimatedParameter("stiffness.k", "N/m", 500.0, 499.0, 501.0),),
    verdict="adequate",
    words="nothing is missing",
    rmse_n=0.02,
    noise_n=0.02,
    runs=3,
    measured_s=12.5,
)
MESSAGES = (INTENT, REPORT, ESTIMATE)
SENDER, HEARER = 77, 78
_TIP_M = (0.4, 0.0, 0.06)
_HEARD = LastReceived(HEARER, 0.0, 0.0)


@dataclass
class FuzzResult:
    """What became of the frames; an exception of either side is not caught."""

    counts: Counter[str] = field(default_factory=Counter)
    targets: set[Target] = field(default_factory=set)  # begun, and not those that were really asked for
    rendered: int = 0  # estimates that the operator would feel, and not those that were really sent


class FedLine:
    """A line whose frames are given; see `palpate.robot_io.link.LinkConnection`."""

    def __init__(self, seal: FrameCode) -> None:
        self.waiting: deque[bytes] = deque()
        self.malformed, self.sender, self._seal = 0, HEARER, seal

    def receive(self) -> list[tuple[float, Frame]]:
        arrived = []
        while self.waiting:
            try:
                arrived.append((0.02, decode(self.waiting.popleft(), self._seal)))
            except FrameError as error:
                self.refuse(str(error))
        return arrived

    def refuse(self, _why: str) -> None:
        """See `LinkConnection.refuse`."""
        self.malformed += 1

    def resubscribe(self) -> None:
        """See `LinkConnection.resubscribe`."""

    def heard(self, frame: Frame, at_s: float) -> None:
        """See `LinkConnection.heard`."""

    def send(self, message: Message) -> None:
        """See `LinkConnection.send`."""


def fuzz(number: int, seed: int, seal: FrameCode = CHECKSUM, mended: FrameCode | None = None) -> FuzzResult:
    """Feed mutated frames to a leader and a follower that hear their peer.

    Args:
        number: of frames.
        seed: of the mutations.
        seal: of the two sides.
        mended: what an attacker seals the mutated frames with again; None for damage on the way.
    """
    rng, result = random.Random(seed), FuzzResult()
    for n in range(number):
        message = MESSAGES[n % len(MESSAGES)]
        data = mutated(encode(SENDER, 1, 0.02, _HEARD, message, seal), rng, seal.size, mended)
        for side in (_follower, _leader):
            side(data, message, seal, result)
    return result


def mutated(data: bytes, rng: random.Random, seal_size: int, mended: FrameCode | None) -> bytes:
    """One to eight bits, bytes or pieces changed, cut out or put in."""
    body = bytearray(data[seal_size:] if mended else data)
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(body))
        kind = rng.randrange(4)
        if kind == 0:
            body[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            body[place] = rng.randrange(256)
        elif kind == 2 and len(body) > 16:
            del body[place : place + rng.randint(1, 8)]
        else:
            body[place:place] = rng.randbytes(rng.randint(1, 8))
    return mended.of(bytes(body)) + bytes(body) if mended else bytes(body)


def _follower(data: bytes, sent: Message, seal: FrameCode, result: FuzzResult) -> None:
    queue = TargetQueue()
    taken = _heard(data, queue.take, Intent, result, sent, seal)
    queue.linked = True
    if taken is not None and (target := queue.begin()) and target not in MESSAGES[0].targets:
        result.targets.add(target)


def _leader(data: bytes, sent: Message, seal: FrameCode, result: FuzzResult) -> None:
    target_states = TargetStates(Scenario())

    def take(message: ObjectEstimate | Report) -> None:
        if isinstance(message, Report):
            target_states.compare(message, 0.02)
            return
        try:
            target_states.take(message)
        except InputError:
            result.counts["an estimate that cannot be felt"] += 1

    if _heard(data, take, ObjectEstimate | Report, result, sent, seal) is not None:
        result.rendered += target_states.choose(_TIP_M) is not None
        target_states.summary(_TIP_M, 1.0)


def _heard(data, take, kinds, result, sent: Message, seal: FrameCode) -> Message | None:
    """What a side that hears its peer takes of a frame, if it says something else than was sent."""
    line, taken = FedLine(seal), []

    def keep(message: Message, _sent_s: float) -> None:
        if isinstance(message, kinds):
            taken.append(message)

    messaging = Messaging(line, SimulatedClock(), take=keep, on_new_peer=lambda: None)
    line.waiting += [encode(SENDER, 0, 0.0, _HEARD, REPORT, seal), data]
    messaging.receive()
    if line.malformed:
        result.counts["refused as malformed"] += 1
    for arrival in set(Arrival) - {Arrival.FRESH}:
        result.counts[str(arrival)] += messaging.peer.counts[arrival]
    new = taken[-1] if taken and taken[-1] not in (sent, REPORT) else None
    if new is not None:
        result.counts["another valid message"] += 1
        take(new)
    return new
