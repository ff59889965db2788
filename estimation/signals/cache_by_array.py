"""Cache results by the identity of the arrays that they were computed from."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from threading import Lock
from typing import Any, TypeVar, cast

from numpy.typing import NDArray

from palpate.estimation.channel import ChannelData
from palpate.robot_io.types import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")
_MOST = 4  # results kept for each function
_LONG = 500_000  # samples; longer arrays are not kept alive by a cache
MOST_BYTES = 64_000_000


class IdentityKey:
    """Key that compares an object by identity and keeps it alive.

    A user-defined effect may be a dataclass, which may equal others and has no hash.
    """

    def __init__(self, thing: Any) -> None:  # noqa: ANN401
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and other.thing is self.thing

    def __hash__(self) -> int:
        return id(self.thing)


def cache_by_array(compute: Function) -> Function:
    """Cache a function of read-only arrays; writable and very long arrays are computed each time.

    Args:
        compute: takes arrays only.
    """
    cached = lru_cache(maxsize=_MOST)(lambda *keys: compute(*(key.thing for key in keys)))

    @wraps(compute)
    def lookup(*arrays: NDArray[Any]) -> Any:  # noqa: ANN401
        if any(array.flags.writeable or len(array) > _LONG for array in arrays):
            return compute(*arrays)
        return cached(*map(IdentityKey, arrays))

    return cast("Function", lookup)


@dataclass(frozen=True)
class _ChannelKey:
    """Identity of a channel, by some of its arrays."""

    arrays: tuple[IdentityKey, ...]
    data: ChannelData = field(compare=False)


def cache_by_channel_arrays(
    *arrays: str,
) -> Callable[[Callable[[ChannelData], Result]], Callable[[ChannelData], Result]]:
    """Cache a function of a channel that depends only on some of its arrays.

    Args:
        arrays: names of fields of the channel, or of signals of its context.
    """

    def decorate(compute: Callable[[ChannelData], Result]) -> Callable[[ChannelData], Result]:
        cached = lru_cache(maxsize=_MOST)(lambda key: compute(key.data))

        @wraps(compute)
        def lookup(data: ChannelData) -> Result:
            chosen = (getattr(data, name) if hasattr(data, name) else data.context[name] for name in arrays)
            return cached(_ChannelKey(tuple(map(IdentityKey, chosen)), data))

        return lookup

    return decorate


@dataclass
class FitCache:
    """Arrays by what they are; those asked for longest ago are forgotten first."""

    size: int = 0  # of all together [bytes]
    _known: OrderedDict[Hashable, FloatArray] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)  # a page computes in several threads

    def __reduce__(self) -> tuple[type["FitCache"], tuple[()]]:
        """Pickle an empty cache: another process computes the arrays sooner than they are sent."""
        return FitCache, ()

    def get_or_compute(self, what: Hashable, compute: Callable[[], FloatArray]) -> FloatArray:
        """Return the cached result for a key, or compute it.

        Args:
            what: key of the array.
            compute: called without arguments where nothing is known.
        """
        with self._lock:
            if what in self._known:
                self._known.move_to_end(what)
                return self._known[what]
        array = compute()
        with self._lock:
            self.size += array.nbytes - (self._known[what].nbytes if what in self._known else 0)
            self._known[what] = array
            while self.size > MOST_BYTES and len(self._known) > 1:
                self.size -= self._known.popitem(last=False)[1].nbytes
        return array
