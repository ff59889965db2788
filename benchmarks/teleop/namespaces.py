"""Two machines on this one: network namespaces whose only way to each other is a relay of IP packets.

The relay delays, jitters and loses whole packets, as netem does where the kernel has it; so TCP and UDP, and
everything above, meet what they would meet on such a network. Needs root and /dev/net/tun.
"""

import ctypes
import fcntl
import os
import select
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.teleop.link import Line, LinkFaults

NAMES = ("palpate-one", "palpate-two")
ADDRESSES = ("10.99.0.1", "10.99.0.2")
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # Linux, linux/if_tun.h
_CLONE_NEWNET = 0x40000000  # Linux, sched.h
_DEVICE, _MOST_BYTES = "link0", 65536


@contextmanager
def namespaces(faults: LinkFaults, seed: int = 0) -> Iterator[tuple[str, ...]]:
    """Both namespaces, with the relay between them, as long as the context is open.

    Raises:
        OSError, subprocess.CalledProcessError: this is not permitted here.
    """
    context = get_context("fork")
    ready, relay = context.Event(), None
    try:
        for name in NAMES:
            _ip("netns", "add", name)
        relay = context.Process(target=_relay, args=(faults, seed, ready), daemon=True)
        relay.start()
        if not ready.wait(10.0):
            raise OSError("the relay has not begun")
        for name, own, other in zip(NAMES, ADDRESSES, ADDRESSES[::-1], strict=True):
            _ip("-n", name, "addr", "add", own, "peer", other, "dev", _DEVICE)
            for device in ("lo", _DEVICE):
                _ip("-n", name, "link", "set", device, "up")
        yield NAMES
    finally:
        if relay is not None:
            relay.kill()
            relay.join()
        for name in NAMES:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def _device(name: str) -> int:
    """A tun device in the namespace; the calling process moves there."""
    with Path("/run/netns", name).open("rb") as namespace:
        if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"no way into the namespace {name}")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", _DEVICE.encode(), _IFF_TUN | _IFF_NO_PI))
    return device


def _relay(faults: LinkFaults, seed: int, ready) -> None:  # noqa: ANN001
    devices = [_device(name) for name in NAMES]
    ready.set()
    line = Line[tuple[int, bytes]](faults, np.random.default_rng(seed))
    while True:
        come, _, _ = select.select(devices, [], [], min(1.0, max(0.0, line.next_s - time.monotonic())))
        for device in come:
            other = devices[1 - devices.index(device)]
            line.send((other, os.read(device, _MOST_BYTES)), time.monotonic())
        for _, (device, packet) in line.arrived(time.monotonic()):
            with suppress(OSError):  # the other side is not up yet
                os.write(device, packet)
