"""Ctrl-C as a request that the loop heeds, not an exception that tears a tick apart."""

import signal
import threading
from types import FrameType
from typing import Any, Self

_ENDING_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Ctrl-C, kill, closed terminal


class InterruptFlag:
    """While entered, the signals that end a program only set a flag; afterwards the former handlers are back.

    A second Ctrl-C changes nothing: the safe stop under way is already the shortest safe way out. Signals
    that the program's parent had switched off (nohup, background jobs) stay off. Outside the main thread,
    where Python allows no handlers, the flag is never set.
    """

    def __init__(self) -> None:
        self.signal_name: str | None = None  # the first signal that came
        self._former: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for name in _ENDING_SIGNALS:
                number = getattr(signal, name, None)  # not every system has every signal
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._former[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._former.clear()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.signal_name = self.signal_name or signal.Signals(number).name
