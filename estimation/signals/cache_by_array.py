"""Cache results by the identity of the arrays that they were computed from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import Any, TypeVar, cast

from numpy.typing import NDArray

from palpate.estimation.channel import ChannelData

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")
_MOST = 4  # results of each function
_LONG = 500_000  # samples; longer arrays are not kept alive by a cache


class IdentityKey:
    """Key that compares an object by identity and keeps it alive.

    An effect of a user's own may be a dataclass, which may equal others and has no hash.
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
    """A channel, identified by some of its arrays."""

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
