"""Results that are remembered for the very arrays that they came from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import Any, TypeVar, cast

from numpy.typing import NDArray

from estimation.channel import ChannelData

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")
_MOST = 4  # channels, of which nothing more is kept
_LONG = 500_000  # samples: what is longer is not kept alive


class Itself:
    """Part of a key that stands for one object, whatever that calls equal to it, and keeps it alive.

    An effect of a user's own may be a dataclass, which is equal to others and has no hash.
    """

    def __init__(self, thing: Any) -> None:  # noqa: ANN401
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and other.thing is self.thing

    def __hash__(self) -> int:
        return id(self.thing)


def of_arrays(compute: Function) -> Function:
    """For a function of arrays: computed once for those that cannot be written into, if they are not long."""
    known = lru_cache(maxsize=_MOST)(lambda *things: compute(*(one.thing for one in things)))

    @wraps(compute)
    def recall(*arrays: NDArray[Any]) -> Any:  # noqa: ANN401
        if any(one.flags.writeable or len(one) > _LONG for one in arrays):
            return compute(*arrays)
        return known(*map(Itself, arrays))

    return cast("Function", recall)


@dataclass(frozen=True)
class _Seen:
    """A channel, known by some of its arrays."""

    arrays: tuple[Itself, ...]
    data: ChannelData = field(compare=False)


def cache_by_array(
    *arrays: str,
) -> Callable[[Callable[[ChannelData], Result]], Callable[[ChannelData], Result]]:
    """For a function of these arrays of a channel: computed once for all channels that have the same ones.

    An array is a field of the channel or a signal of its context.
    """

    def decorate(compute: Callable[[ChannelData], Result]) -> Callable[[ChannelData], Result]:
        known = lru_cache(maxsize=_MOST)(lambda seen: compute(seen.data))

        @wraps(compute)
        def recall(data: ChannelData) -> Result:
            return known(_Seen(tuple(Itself(_array(data, name)) for name in arrays), data))

        return recall

    return decorate


def _array(data: ChannelData, name: str) -> object:
    return getattr(data, name) if hasattr(data, name) else data.context[name]
