"""Parts for session tests: streams, data with a known content, and strategies."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from palpate.robot_io.session import Column, SessionMetadata, Stream
from palpate.robot_io.session.stream import DTYPES

# About 40 numbers a record, as a tick of the loop has.
TICK = Stream(
    "tick",
    (
        Column("tick", "1", 1, "number of the tick", "int64"),
        Column("time_s", "s", 1, "start of the tick"),
        *(Column(f"joint_{i}", "rad", 3) for i in range(8)),
        *(Column(f"value_{i}", "N") for i in range(12)),
        Column("status", "1", 1, "", "int32"),
        Column("tripped", "1", 1, "", "bool"),
    ),
)

METADATA = SessionMetadata(
    robot_file="name: follower\n",
    urdf="<robot name='ü'/>",
    calibration="gain: 1.5",
    scenario="seed: 3",
    software_version="0.1.0",
    seed=12,
    created_utc="2025-01-02T03:04:05+00:00",
    command_line="palpate probe",
    extra={"note": "a\nb"},
)


def tick(number: int) -> tuple[object, ...]:
    """A record whose every value follows from its number."""
    joints = tuple(np.array([number, -number, 0.5 * number]) + i for i in range(8))
    values = tuple(number * 1e-3 + i for i in range(12))
    return (number, number * 1e-3, *joints, *values, number % 4, number % 2 == 1)


def ticks(numbers) -> np.ndarray:
    """The records of these numbers, shape (n,); computed at once, as tests compare thousands of them."""
    number = np.asarray(numbers, dtype=np.int64)
    records = np.zeros(len(number), TICK.dtype)
    records["tick"], records["time_s"] = number, number * 1e-3
    for i in range(8):
        records[f"joint_{i}"] = np.column_stack([number, -number, 0.5 * number]) + i
    for i in range(12):
        records[f"value_{i}"] = number * 1e-3 + i
    records["status"], records["tripped"] = number % 4, number % 2 == 1
    return records


def assert_ticks(samples, numbers) -> None:
    expected = ticks(numbers)
    for name in TICK.dtype.names:
        np.testing.assert_array_equal(samples[name], expected[name])


@st.composite
def streams(draw, name="stream") -> Stream:
    names = draw(
        st.lists(st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,12}", fullmatch=True), unique=True, max_size=20)
    )
    columns = [
        Column(
            n,
            draw(st.text(max_size=5)),
            draw(st.just(1) | st.integers(2, 40)),
            draw(st.text(max_size=9)),
            draw(st.sampled_from(DTYPES)),
        )
        for n in names
        if n != "time_s"
    ]
    columns.insert(draw(st.integers(0, len(columns))), Column("time_s", "s"))
    return Stream(name, tuple(columns))


@st.composite
def streams_with_columns(draw, name="stream"):
    """A stream and its columns, of any bits: NaN with payloads, infinities and extreme integers too."""
    stream = draw(streams(name))
    count = draw(st.integers(0, 30))
    columns = {
        c.name: draw(
            hnp.arrays(np.dtype(c.dtype), (count, *c.shape), elements=hnp.from_dtype(np.dtype(c.dtype)))
        )
        for c in stream.columns
    }
    return stream, columns
