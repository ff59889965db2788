"""One side of a teleoperation that repeats its messages, here or in a process."""

import time
from multiprocessing import get_context
from multiprocessing.context import SpawnProcess

from palpate.control.loop.task import Phase
from palpate.control.teleop.messaging import Arrival, Peer
from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.link.connection import LinkConnection, LinkSettings
from palpate.robot_io.link.messages import ObjectEstimate, Report
from tests.robot_io.link.link_parts import intent, report, target

WAIT_S = 120.0  # for a machine that has much else to do


class ScriptedPeer:
    """`until` talks until something is heard."""

    def __init__(self, role: str, port: int) -> None:
        self.line, self.peer = (LinkConnection(role, LinkSettings(port=port), MonotonicClock()), Peer())
        self.seen = -1
        self.heard: list[Report | ObjectEstimate] = []

    def until(self, says, reached, wait_s: float = WAIT_S) -> None:
        end_s = time.monotonic() + wait_s
        while not reached(self):
            assert time.monotonic() < end_s, f"never reached; heard last: {self.heard[-1:]}"
            for at_s, frame in self.line.receive():
                if self.peer.classify(frame, at_s) is Arrival.FRESH:
                    self.line.heard(frame, at_s)
                    self.heard.append(frame.message)
            self.line.send(says(self))
            time.sleep(0.02)

    @property
    def last(self):
        return self.heard[-1] if self.heard else None


def lead_until_hold(port: int, reached) -> None:
    """Ask for two places, and say when the first one is held; for a process of its own."""
    side, wanted = ScriptedPeer("leader", port), intent(target(0, 0.40), target(1, 0.42))
    side.until(lambda _: wanted, lambda side: isinstance(side.last, Report) and side.last.phase == Phase.HOLD)
    reached.set()
    side.until(lambda _: wanted, lambda _: False)


def follow_until_asked(port: int, reached) -> None:
    """Report from an arm that stands still, and say when a target is wanted; for a process of its own."""
    side, moment = ScriptedPeer("follower", port), report(target=-1, targets=(), states=())
    side.until(lambda _: moment, lambda side: bool(getattr(side.last, "targets", ())))
    reached.set()
    side.until(lambda _: moment, lambda _: False)


def killed_when_reached(messaging, port: int) -> SpawnProcess:
    """Run one of the above in a process, and kill it (SIGKILL) once it has got there."""
    context = get_context("spawn")
    reached = context.Event()
    process = context.Process(target=messaging, args=(port, reached), daemon=True)
    process.start()
    assert reached.wait(WAIT_S)
    process.kill()
    process.join()
    return process
