"""What both sides keep of the line: the stream called "link", and its records."""

from math import nan

from control.teleop.peer import Arrival, Peer
from robot_io.session import Column, Stream

STREAM_NAME = "link"
LINK_STREAM = Stream(
    STREAM_NAME,
    (
        Column("time_s", "s", 1, "on this side's clock"),
        Column("peer_offset_s", "s", 1, "the peer's clock minus this one; NaN before it is known"),
        Column("round_trip_s", "s", 1, "of the exchange that the offset comes from"),
        Column("age_s", "s", 1, "of what the newest fresh message says"),
        Column("silent", "1", 1, "whether the peer is silent", "bool"),
        *(Column(kind.value, "1", 1, "frames so far", "int64") for kind in Arrival),
        Column("malformed", "1", 1, "frames so far", "int64"),
        Column("lost", "1", 1, "frames that never came, so far", "int64"),
    ),
)


def link_record(peer: Peer, malformed: int, now_s: float) -> tuple[object, ...]:
    """One record of `LINK_STREAM`."""
    offset = peer.offset
    clocks = (nan, nan) if offset is None else (offset.offset_s, offset.round_trip_s)
    counts = (peer.counts[kind] for kind in Arrival)
    return (now_s, *clocks, peer.age_s(now_s), peer.silent(now_s), *counts, malformed, peer.lost)
