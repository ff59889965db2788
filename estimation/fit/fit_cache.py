"""What was computed for one model and is the same in others, such as an effect's columns on blocks."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import Lock

from palpate.robot_io.types import FloatArray

MOST_BYTES = 64_000_000


@dataclass
class FitCache:
    """Arrays by what they are; those asked for longest ago are forgotten first."""

    size: int = 0  # of all together [bytes]
    _known: OrderedDict[Hashable, FloatArray] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)  # a page computes in several threads

    def __reduce__(self) -> tuple[type["FitCache"], tuple[()]]:
        """For another process: it begins with nothing, and computes what it needs sooner than it is sent."""
        return FitCache, ()

    def get_or_compute(self, what: Hashable, compute: Callable[[], FloatArray]) -> FloatArray:
        """What was computed for `what` before, or is now."""
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
