"""Feeds a codec with random and damaged bytes: it may refuse them with its own error and nothing else."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from robot_io.errors import ProtocolError
from robot_io.registry import Registry

MAX_RANDOM = 64  # bytes of a random input


class Fuzzer(ABC):
    """One codec under fire. It may keep state from input to input, as a stream's decoder does."""

    name: ClassVar[str]

    @abstractmethod
    def frame(self, rng: np.random.Generator) -> bytes:
        """Something valid, to be damaged."""

    @abstractmethod
    def decode(self, data: bytes) -> list[object]:
        """What the codec accepts of `data`. ProtocolError: it refuses; any other exception is a defect."""

    @abstractmethod
    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """Whether something accepted should not have been, judged without the codec."""


class Decoder(Protocol):
    """What finds values or packets in a stream."""

    def feed(self, data: bytes) -> Iterable[object]:
        """What has come to its end with this."""
        ...


class StreamFuzzer(Fuzzer):
    """One endless stream; what is accepted may have begun in earlier inputs, the last of which are `seen`."""

    memory = 400  # bytes

    def __init__(self, stream: Decoder) -> None:
        self.stream, self.seen = stream, b""

    def decode(self, data: bytes) -> list[object]:
        self.seen = (self.seen + data)[-self.memory - len(data) :]
        return list(self.stream.feed(data))


@dataclass(frozen=True)
class FuzzResult:
    """What came of it."""

    inputs: int  # how many were fed
    accepted: int  # values that were believed
    refused: int  # inputs that were refused with the codec's own error
    wrong: tuple[str, ...]  # descriptions of values that should not have been believed
    crashes: tuple[str, ...]  # descriptions of other exceptions
    slowest_s: float  # longest time for one input [s]


def all_fuzzers() -> Registry[Fuzzer]:
    """Every codec's fuzzer by name."""
    return Registry("codec", Fuzzer, f"{__package__}.codecs")  # type: ignore[type-abstract]


def run_fuzzer(fuzzer: Fuzzer, inputs: int, rng: np.random.Generator) -> FuzzResult:
    """Feed `inputs` inputs, a quarter of them random and the others damaged frames."""
    accepted = refused = 0
    wrong: list[str] = []
    crashes: list[str] = []
    slowest_s = 0.0
    for _ in range(inputs):
        data = _make_input(fuzzer, rng)
        before_s = time.perf_counter()
        try:
            values = fuzzer.decode(data)
        except ProtocolError:
            refused += 1
            values = []
        except Exception as error:
            crashes.append(f"{type(error).__name__}: {error} for {data.hex()}")
            values = []
        slowest_s = max(slowest_s, time.perf_counter() - before_s)
        accepted += len(values)
        wrong += [f"{value} from {data.hex()}" for value in values if fuzzer.is_wrong(data, value)]
    return FuzzResult(inputs, accepted, refused, tuple(wrong), tuple(crashes), slowest_s)


def _make_input(fuzzer: Fuzzer, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.25:
        return rng.bytes(int(rng.integers(MAX_RANDOM)))
    data = bytearray(fuzzer.frame(rng))
    for _ in range(int(rng.integers(3))):
        _damage(data, rng)
    if rng.random() < 0.1:
        data += fuzzer.frame(rng)[: int(rng.integers(1, 20))]
    return bytes(data)


def _damage(data: bytearray, rng: np.random.Generator) -> None:
    place = int(rng.integers(len(data) + 1))
    kind = int(rng.integers(4))
    if kind == 0 and place < len(data):
        data[place] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del data[place : place + int(rng.integers(1, 4))]
    elif kind == 2:
        data[place:place] = rng.bytes(int(rng.integers(1, 4)))
    else:
        data[place:place] = data[place : place + 4]
