"""Cache results by the identity of the arrays from which they were computed."""

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from threading import Lock
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from palpate.estimation.channel import ChannelData

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")
Array = TypeVar("Array", bound=NDArray[Any])
_MAX_RESULTS = 8  # results kept for each function, so that the joints of an arm are computed once
_MAX_SAMPLES = 500_000  # samples; longer arrays are not kept alive by a cache
MAX_BYTES = 64_000_000


class IdentityKey:
    """Key that compares an object by identity and keeps it alive.

    It is needed because a user-defined effect may be a dataclass, which can equal others and has no hash.
    """

    def __init__(self, wrapped: Any) -> None:  # noqa: ANN401
        self.wrapped = wrapped

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and other.wrapped is self.wrapped

    def __hash__(self) -> int:
        return id(self.wrapped)


def cache_by_array(compute: Function) -> Function:
    """Cache a function of read-only arrays; results for writable or very long arrays are not cached.

    Args:
        compute: function whose arguments are arrays and numbers.
    """
    # An entry keeps its arrays alive, so that their identities remain valid. Comparing identities takes far
    # less time than comparing objects that wrap the arrays.
    entry_of = lru_cache(maxsize=_MAX_RESULTS)(lambda *key: [])

    @wraps(compute)
    def lookup(*arguments: NDArray[Any] | float) -> Any:  # noqa: ANN401
        key: list[Hashable] = []
        for argument in arguments:
            if not isinstance(argument, np.ndarray):
                key.append(argument)
            elif argument.flags.writeable or len(argument) > _MAX_SAMPLES:
                return compute(*arguments)
            else:
                key.append(id(argument))
        entry = entry_of(*key)
        if not entry:
            entry.append((compute(*arguments), arguments))
        return entry[0][0]

    return cast("Function", lookup)


@dataclass(frozen=True)
class _ChannelKey:
    """Key that identifies a channel by some of its arrays."""

    arrays: tuple[IdentityKey, ...]
    data: ChannelData = field(compare=False)


def cache_by_channel_arrays(
    *arrays: str,
) -> Callable[[Callable[[ChannelData], Result]], Callable[[ChannelData], Result]]:
    """Cache a function of a channel that depends only on some of its arrays; very long ones are not cached.

    Args:
        arrays: names of channel fields or of context signals, which a channel may lack.
    """

    def decorate(compute: Callable[[ChannelData], Result]) -> Callable[[ChannelData], Result]:
        cached = lru_cache(maxsize=_MAX_RESULTS)(lambda key: compute(key.data))

        @wraps(compute)
        def lookup(data: ChannelData) -> Result:
            if len(data) > _MAX_SAMPLES:
                return compute(data)
            chosen = (getattr(data, name, data.context.get(name)) for name in arrays)
            return cached(_ChannelKey(tuple(map(IdentityKey, chosen)), data))

        return lookup

    return decorate


@dataclass
class FitCache:
    """Cache of arrays by key, which discards the least recently used arrays first."""

    total_bytes: int = 0  # total size of the arrays and of those that the keys keep alive [bytes]
    _entries: OrderedDict[Hashable, tuple[NDArray[Any], NDArray[Any] | None]] = field(
        default_factory=OrderedDict
    )
    _uses: Counter[int] = field(default_factory=Counter)  # keys that keep an array alive, by its identity
    _lock: Lock = field(default_factory=Lock)  # a page computes in several threads

    def __reduce__(self) -> tuple[type["FitCache"], tuple[()]]:
        """Pickle as an empty cache, since computing the arrays is faster than sending them."""
        return FitCache, ()

    def get_or_compute(
        self, key: Hashable, compute: Callable[[], Array], kept: NDArray[Any] | None = None
    ) -> Array:
        """Return the cached result for a key, or compute it and make it read-only, since callers share it.

        Args:
            key: key of the array.
            compute: function without arguments that computes the array if it is not cached.
            kept: array that the key keeps alive.
        """
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
                return cast("Array", self._entries[key][0])
        array = compute()
        array.setflags(write=False)
        with self._lock:
            if key in self._entries:  # computed by two threads at once
                self._discard(key)
            self._entries[key] = array, kept
            self.total_bytes += array.nbytes
            if kept is not None:
                self.total_bytes += 0 if self._uses[id(kept)] else kept.nbytes
                self._uses[id(kept)] += 1
            while self.total_bytes > MAX_BYTES and len(self._entries) > 1:
                self._discard(next(iter(self._entries)))
        return array

    def _discard(self, key: Hashable) -> None:
        array, kept = self._entries.pop(key)
        self.total_bytes -= array.nbytes
        if kept is not None:
            self._uses[id(kept)] -= 1
            if not self._uses[id(kept)]:
                del self._uses[id(kept)]
                self.total_bytes -= kept.nbytes
