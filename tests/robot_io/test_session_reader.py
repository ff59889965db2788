import os
import stat
import struct
import tracemalloc
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from palpate.robot_io.errors import InputError, SessionError, UnknownNameError
from palpate.robot_io.files import atomic_write
from palpate.robot_io.session import (
    Column,
    Event,
    Session,
    SessionMetadata,
    SessionTail,
    Stream,
    mcap_file,
    write_session,
    writer,
)
from palpate.robot_io.session.mcap_file import CHUNK_BYTES, END_RECORD, EXTRA_RECORD, HEADER_RECORD, McapFile
from palpate.robot_io.session.stream import Samples, streams_to_json
from palpate.robot_io.session.wire import WireFormat
from tests.files import saved
from tests.robot_io.session_parts import METADATA, TICK, assert_ticks, streams_with_columns, ticks

SLOW = Stream("slow", (Column("time_s", "s"), Column("x", "m", 1, "into the object")))
EVENTS = (Event(0.5, "mark", "hello", {"a": [1, None]}), Event(0.6, "trip", "", None))

within_one_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(path, count=1500):
    slow = {"time_s": np.array([0.1, 0.2]), "x": np.array([np.nan, -np.inf])}
    records = ticks(range(count))
    fast = {name: records[name] for name in records.dtype.names}
    return write_session(path, [(TICK, fast), (SLOW, slow)], METADATA, EVENTS)


def opened(path):
    """The session, or None if it was refused in one line that names the file."""
    error_text = None
    try:
        return Session.open(path)
    except SessionError as error:
        error_text = str(error)
    assert error_text.startswith(f"{path}: ")
    assert "\n" not in error_text
    return None


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return written(tmp_path_factory.mktemp("session") / "s.mcap").read_bytes()


def test_session_written_at_once_is_read_back(tmp_path):
    session = Session.open(str(written(tmp_path / "new" / "s.mcap")))
    assert session.metadata == METADATA
    assert session.events == EVENTS
    assert (session.truncated, session.dropped, session.stream_names) == (False, 0, ("tick", "slow"))
    assert_ticks(session.samples("tick"), range(1500))
    np.testing.assert_array_equal(session.samples("slow")["x"], [np.nan, -np.inf])
    assert session.samples("slow").stream == SLOW
    assert session.samples("slow").units == {"time_s": "s", "x": "m"}
    assert session.derived_dir == tmp_path / "new" / "s"


@within_one_folder
@given(streams_with_columns("one"), streams_with_columns("two"))
def test_any_streams_come_back_bit_by_bit(tmp_path, one, two):
    path = tmp_path / "s.mcap"
    path.unlink(missing_ok=True)
    session = Session.open(write_session(path, [one, two], SessionMetadata()))
    for stream, columns in (one, two):
        samples = session.samples(stream.name)
        for name, values in columns.items():
            assert samples[name].dtype == values.dtype
            assert samples[name].shape == values.shape
            assert samples[name].tobytes() == values.tobytes()


def assert_full_chunks(summary):
    """A crash costs 64 KiB at most, and each chunk is not much smaller but for the last of a stream."""
    sizes = sorted(index.uncompressed_size for index in summary.chunk_indexes)
    assert 0.7 * 65_536 < sizes[len(sizes) // 2] <= sizes[-1] <= 65_536


def test_chunk_of_long_records_costs_no_more_than_others(tmp_path):
    """Four of these records with their headers would be 65,548 bytes."""
    stream = Stream("wide", (Column("time_s", "s"), Column("x", "m", 2043)))
    columns = {"time_s": np.arange(12.0), "x": np.zeros((12, 2043))}
    with write_session(tmp_path / "s.mcap", [(stream, columns)], METADATA).open("rb") as file:
        assert_full_chunks(make_reader(file).get_summary())


@pytest.fixture
def in_batches(monkeypatch):
    """A stream of more than 1,000 records is written with several in a message."""
    monkeypatch.setattr(writer, "_MANY", 1000)


@pytest.mark.parametrize("count", [1001, 8000])
def test_long_session_has_many_records_in_a_message_and_is_read_back(tmp_path, in_batches, count):
    path = written(tmp_path / "s.mcap", count)
    session = Session.open(path)
    assert (session.truncated, session.dropped, session.events) == (False, 0, EVENTS)
    assert_ticks(session.samples("tick"), range(count))
    assert (session.samples("tick").stream, session.samples("slow").stream) == (TICK, SLOW)
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert_full_chunks(summary)
    assert summary.statistics.message_count < count / 20
    again = write_session(
        tmp_path / "short.mcap", [(session.samples("slow").stream, session.samples("slow").columns)], METADATA
    )
    assert mcap_file.scan(BytesIO(path.read_bytes())).metadata[HEADER_RECORD]["format_version"] == "2"
    assert mcap_file.scan(BytesIO(again.read_bytes())).metadata[HEADER_RECORD]["format_version"] == "1"


def test_short_session_has_a_record_in_each_message(tmp_path, in_batches):
    with written(tmp_path / "s.mcap", 1000).open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == 1000 + 2 + len(EVENTS)


@within_one_folder
@given(share=st.floats(0.05, 0.99))
def test_truncated_long_session_yields_all_earlier_records(tmp_path, in_batches, share):
    whole = tmp_path / "whole.mcap"
    content = (whole if whole.exists() else written(whole, 5000)).read_bytes()
    session = Session.open(saved(tmp_path / "s.mcap", content[: int(share * len(content))]))
    assert (session.truncated, session.dropped) == (True, 0)
    assert_ticks(session.samples("tick"), range(len(session.samples("tick"))))
    assert len(session.samples("tick")) > 5000 * share - 700


@pytest.mark.parametrize("batch", [2, 16])
@pytest.mark.parametrize("stated", [{"slow": 40}, {"slow": 3}, {}])
def test_lost_message_of_many_records_is_counted_record_by_record(tmp_path, in_batches, stated, batch):
    path = tmp_path / "s.mcap"
    stream = replace(SLOW, batch=batch)
    rows = SLOW.records({"time_s": np.arange(40.0), "x": np.zeros(40)})
    with path.open("wb") as file:
        mcap = McapFile(file, [stream], METADATA)
        mcap.write_records("slow", np.arange(16, dtype=np.uint64), rows[:16])
        mcap.write_records("slow", np.arange(32, 40, dtype=np.uint64), rows[32:])
        mcap.finish(stated)
    session = Session.open(path)
    assert session.samples("slow")["time_s"].tolist() == [*range(16), *range(32, 40)]
    assert session.dropped == 16
    assert mcap_file.scan(BytesIO(path.read_bytes())).metadata[HEADER_RECORD]["format_version"] == "2"


@pytest.mark.parametrize(
    ("limit", "value", "said"),
    [
        ("reader.MAX_FILE_BYTES", 1000, "more than the limit of"),
        ("mcap_file.MAX_DATA_BYTES", 100_000, "far more data than a session file of this size"),
    ],
)
def test_more_data_than_any_session_or_memory_is_refused(tmp_path, monkeypatch, limit, value, said):
    path = written(tmp_path / "s.mcap")
    monkeypatch.setattr(f"palpate.robot_io.session.{limit}", value)
    with pytest.raises(SessionError, match=said):
        Session.open(path)


def test_other_programs_can_read_the_file(tmp_path):
    with written(tmp_path / "s.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert {c.topic for c in summary.channels.values()} == {"events", "tick", "slow"}
        names = {schema.name for schema in summary.schemas.values()}
        assert names == {"palpate.events", "palpate.tick", "palpate.slow"}
        assert_full_chunks(summary)
        assert len(summary.chunk_indexes) > 5
        times = [message.log_time for _, _, message in reader.iter_messages("tick", starting_at=10**9)]
        assert times == [n * 10**6 for n in range(1000, 1500)]


def test_time_that_mcap_cannot_hold_is_zero_there(tmp_path):
    times_s = np.array((np.nan, -1.0, 1.5))
    path = tmp_path / "s.mcap"
    with path.open("wb") as file:
        mcap = McapFile(file, [SLOW], METADATA)
        rows = SLOW.records({"time_s": times_s, "x": np.zeros(3)})
        mcap.write_records("slow", np.arange(3, dtype=np.uint64), rows)
        mcap.finish({"slow": 3})
    with path.open("rb") as file:
        assert [message.log_time for *_, message in make_reader(file).iter_messages()] == [0, 0, 15 * 10**8]
    np.testing.assert_array_equal(Session.open(path).samples("slow")["time_s"], times_s)


@within_one_folder
@given(st.data())
def test_truncated_file_yields_all_earlier_records(tmp_path, whole, data):
    length = data.draw(st.integers(0, len(whole) - 1))
    session = opened(saved(tmp_path / "s.mcap", whole[:length]))
    if session is None:
        assert length < 3000, "the header is there already"
        return
    assert session.truncated
    assert session.metadata == METADATA
    assert session.dropped == 0
    samples = session.samples("tick")
    assert_ticks(samples, range(len(samples)))
    lost = 1500 - len(samples)
    assert lost <= 1500 * (len(whole) - length) / len(whole) + 2 * CHUNK_BYTES / TICK.dtype.itemsize


def third_chunk(whole):
    """Where its third chunk begins."""
    summary = make_reader(BytesIO(whole)).get_summary()
    return sorted(index.chunk_start_offset for index in summary.chunk_indexes)[2]


@pytest.mark.parametrize("kept", [0, 1, 23])
def test_file_cut_in_a_chunk_header_gives_the_chunks_before(tmp_path, whole, kept):
    path = tmp_path / "s.mcap"
    path.write_bytes(whole[: third_chunk(whole) + 1 + 8 + kept])  # behind opcode and length
    samples = Session.open(path).samples("tick")
    assert_ticks(samples, range(len(samples)))
    assert len(samples) > 100


@within_one_folder
@given(st.data())
def test_damaged_file_is_refused_or_read_unchanged(tmp_path, whole, data):
    place = data.draw(st.integers(0, len(whole) - 1))
    flipped = bytearray(whole)
    flipped[place] ^= data.draw(st.integers(1, 255))
    session = opened(saved(tmp_path / "s.mcap", flipped))
    if session is None:
        return
    if session.truncated:  # its very end was hit, so that it looks like one that was cut off
        assert place >= len(whole) - 8
    assert session.metadata == METADATA
    assert_ticks(session.samples("tick"), range(1500))


@pytest.mark.parametrize(
    ("text", "damaged"),
    [(b"gain: 1.5", b"gain: 7.5"), (b"seed: 3", b"seed: 8"), (b"0.1.0", b"0.9.0"), (b"a\nb", b"a\nc")],
)
def test_damaged_text_of_a_finished_file_is_refused(tmp_path, whole, text, damaged):
    """It may be a calibration; no chunk covers it, only the checksum of the whole."""
    assert whole.count(text) == 1
    with pytest.raises(SessionError, match="the checksum of its data does not match"):
        Session.open(saved(tmp_path / "s.mcap", whole.replace(text, damaged)))


@within_one_folder
@given(junk=st.binary(max_size=2000), keep=st.integers(8, 3000), close=st.booleans())
def test_junk_after_a_good_beginning_never_breaks_the_reader(tmp_path, whole, junk, keep, close):
    session = opened(saved(tmp_path / "s.mcap", whole[:keep] + junk + (whole[:8] if close else b"")))
    assert session is None or session.truncated


LOST_MESSAGE = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 9, 0, 0, 0)  # of channel 9
CHUNK_OF_IT = struct.pack("<QQQIIQ", 0, 0, 31, crc32(LOST_MESSAGE), 0, 31) + LOST_MESSAGE


@pytest.mark.parametrize(
    ("opcode", "content", "said"),
    [
        (Opcode.METADATA, b"\xff\xff", "damaged: (?!its end)"),
        (Opcode.METADATA, b"\1\0\0\0\xff\0\0\0\0", "damaged: a text in it is not UTF-8"),
        (Opcode.CHUNK, bytes(16) + b"\xff" * 8 + bytes(16), "a chunk of 18446744073709551615 bytes"),
        (Opcode.CHUNK, bytes(16) + b"\1\0\x40" + bytes(21), "a chunk of 4194305 bytes; at most 4194304"),
        (Opcode.CHUNK, bytes(16) + b"\0\0\x40" + bytes(21), "the checksum of a chunk"),
        (Opcode.CHUNK, CHUNK_OF_IT, r"damaged: a message belongs to no channel \(9\)"),
    ],
)
def test_damage_in_a_finished_file_is_reported(tmp_path, whole, opcode, content, said):
    path, record = tmp_path / "s.mcap", bytes((opcode,)) + len(content).to_bytes(8, "little") + content
    path.write_bytes(whole[:8] + record + whole[8:])
    with pytest.raises(SessionError, match=said):
        Session.open(path)


@pytest.mark.parametrize("more", [0, 1000])
def test_finished_file_without_its_middle_is_refused(tmp_path, whole, more):
    path = saved(tmp_path / "s.mcap", whole[: third_chunk(whole) + more] + whole[-8:])
    with pytest.raises(SessionError, match="its end is present, but parts before it are missing"):
        Session.open(path)


def test_damage_in_a_growing_file_is_reported(tmp_path, whole):
    path = tmp_path / "s.mcap"
    path.write_bytes(whole[:8] + bytes((Opcode.METADATA,)) + (2).to_bytes(8, "little") + b"\xff\xff")
    with pytest.raises(SessionError, match="damaged"):
        SessionTail(path, "tick", last=10).read()


def foreign(path, header, messages=(), compression=CompressionType.LZ4, stream=SLOW, end=None):
    """An MCAP file by somebody else."""
    with path.open("wb") as file:
        mcap = Writer(file, compression=compression, chunk_size=10**6)
        mcap.start()
        if header is not None:
            good = {"format_version": "1", "streams": streams_to_json((stream,))}
            mcap.add_metadata(HEADER_RECORD, good | header)
        schema = mcap.register_schema("x", "protobuf", b"")
        channel = mcap.register_channel("slow", "protobuf", schema)
        events = mcap.register_channel("events", "protobuf", schema)
        for topic, data in messages:
            mcap.add_message({"slow": channel, "events": events}[topic], 0, data, 0)
        if end is not None:
            mcap.add_metadata(END_RECORD, {"slow": end})
        mcap.finish()
    return path


MESSAGE = WireFormat(SLOW).encode(SLOW.records({"time_s": [0.0], "x": [1.0]}))[0]


def test_writing_a_long_session_reports_progress(tmp_path):
    shares, count = [], 40_000
    path = write_session(
        tmp_path / "s",
        [(SLOW, {"time_s": np.arange(count) / 1e3, "x": np.arange(count) * 1.0})],
        METADATA,
        progress=shares.append,
    )
    assert len(shares) > 2
    assert sorted(shares) == shares
    assert shares[-1] == 1.0
    assert Session.open(path).samples("slow")["x"].tolist() == list(range(count))


@pytest.mark.parametrize(
    ("end", "dropped"),
    [(None, 0), ("1", 0), ("5", 4), ("0", 0), ("-3", 0), ("many", 0), ("9" * 19, 10**19 - 2), ("9" * 20, 0)],
)
def test_plausible_count_of_lost_records_is_used(tmp_path, end, dropped):
    session = Session.open(foreign(tmp_path / "s", {}, [("slow", MESSAGE)], end=end))
    assert (session.samples("slow")["x"].tolist(), session.dropped) == ([1.0], dropped)
    assert not session.truncated


@pytest.mark.parametrize(("flip", "count"), [(0, 1), (1, 0)])
def test_damaged_chunk_of_a_truncated_session_is_skipped(tmp_path, flip, count):
    path = foreign(tmp_path / "s", {}, [("slow", MESSAGE)], CompressionType.NONE)
    whole = path.read_bytes()
    cut = bytearray(whole[: whole.index(MESSAGE) + len(MESSAGE)])
    cut[-1] ^= flip
    path.write_bytes(cut)
    session = Session.open(path)
    assert (session.truncated, len(session.samples("slow"))) == (True, count)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"header": None}, "not a palpate session"),
        ({"header": {"format_version": "3"}}, "format version '3'"),
        ({"header": {"streams": "nonsense"}}, "streams"),
        ({"header": {"streams": streams_to_json((SLOW, SLOW))}}, "slow appears twice"),
        ({"header": {"streams": "[" * 50_000}}, "streams"),
        (
            {"header": {"streams": streams_to_json((SLOW,)).replace('"batch": 1', '"batch": 0')}},
            "batch 0 must be a positive integer",
        ),
        (
            {"header": {"streams": streams_to_json((SLOW,)).replace('"batch": 1', '"batch": "9"')}},
            "batch '9' must be a positive integer",
        ),
        (
            {"header": {"streams": streams_to_json((SLOW,)).replace('"batch": 1', '"batch": 9999')}},
            "9999 rec",
        ),
        ({"header": {"streams": '["slow"]'}}, "streams"),
        ({"header": {"seed": "many"}}, "many"),
        ({"header": {"created_utc": "yesterday"}}, "yesterday"),
        ({"header": {}, "messages": [("slow", MESSAGE[:-1])]}, "slow"),
        ({"header": {}, "messages": [("slow", b"\0" * len(MESSAGE))]}, "slow"),
        ({"header": {}, "messages": [("events", b"\xff\xff")]}, "event"),
        ({"header": {}, "messages": [("events", b"\x22\x02[]")]}, "not a JSON object"),
        ({"header": {}, "messages": [("events", b"\x22\x01{")]}, "event"),
        ({"header": {}, "messages": [("slow", MESSAGE)], "compression": CompressionType.ZSTD}, "zstd"),
        ({"header": {}, "messages": [("events", bytes(5_000_000))]}, "chunk of 5"),
    ],
)
def test_irregular_file_is_refused_in_one_line(tmp_path, arguments, word):
    path = foreign(tmp_path / "s.mcap", **arguments)
    with pytest.raises(SessionError, match=word):
        Session.open(path)
    assert opened(path) is None


def test_session_that_expands_beyond_memory_is_refused(tmp_path, monkeypatch):
    path = foreign(tmp_path / "s.mcap", {}, [("events", bytes(4_000_000))] * 10)
    monkeypatch.setattr(atomic_write, "_ALLOWED_BYTES", 1_000_000)
    with pytest.raises(SessionError, match="far more data"):
        Session.open(path)


def other_file(folder, kind):
    path = folder / "s.mcap"
    if kind == "folder":
        path.mkdir()
    elif kind == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a", "b")
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind != "missing":
        path.write_bytes({"empty": b"", "text": b"time_s,force_N\n0,1\n", "magic": b"\x89MCAP0\r\n"}[kind])
    return path


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "zip", "magic", "fifo"])
def test_invalid_session_is_refused_in_one_line(tmp_path, kind):
    assert opened(other_file(tmp_path, kind)) is None


def test_samples_are_read_only_and_can_be_selected(tmp_path):
    samples = Session.open(written(tmp_path / "s.mcap")).samples("tick")
    assert_ticks(Samples.from_records(TICK, ticks(range(1500))), range(1500))
    late = samples.select(samples["time_s"] >= 1.499)
    assert_ticks(late, [1499])
    assert_ticks(samples.select([3, 1]), [3, 1])
    for one in (samples, late):
        with pytest.raises(ValueError, match="read-only"):
            one["time_s"][0] = 3.0
        with pytest.raises(TypeError):
            one.columns["time_s"] = np.zeros(3)
    assert samples.vector("joint_0").shape == (1500, 3)
    assert samples.vector("value_0").shape == (1500, 1)
    assert "joint_0" in samples
    assert list(samples) == [column.name for column in TICK.columns]


def test_unknown_names_list_the_valid_ones(tmp_path):
    session = Session.open(written(tmp_path / "s.mcap"))
    with pytest.raises(UnknownNameError, match=r"'tock'\. Valid: tick, slow"):
        session.samples("tock")
    with pytest.raises(UnknownNameError, match="did you mean 'tripped'"):
        session.samples("tick")["triped"]


def test_failed_write_leaves_no_file(tmp_path, monkeypatch):
    good = {"time_s": [0.0], "x": [1.0]}
    with pytest.raises(InputError, match="expected"):
        write_session(tmp_path / "s", [(SLOW, good | {"x": [1.0, 2.0]})], METADATA)
    with pytest.raises(SessionError, match="File name too long"):
        write_session(tmp_path / ("x" * 250), [(SLOW, good)], METADATA)
    monkeypatch.setattr(McapFile, "finish", lambda *_: Path("/dev/full").write_bytes(b"x"))
    with pytest.raises(SessionError, match="No space left"):
        write_session(tmp_path / "s", [(SLOW, good)], METADATA)
    assert os.listdir(tmp_path) == []


def test_writing_at_once_overwrites_nothing_and_respects_the_umask(tmp_path):
    path = written(tmp_path / "s.mcap")
    assert os.listdir(tmp_path) == ["s.mcap"]
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)
    before = path.read_bytes()
    with pytest.raises(SessionError, match="already exists"):
        written(path, 3)
    assert path.read_bytes() == before
    late, columns = tmp_path / "late.mcap", {"time_s": np.zeros(1), "x": np.zeros(1)}
    with pytest.raises(SessionError, match="already exists"):
        write_session(late, [(SLOW, columns)], METADATA, progress=lambda _: late.write_bytes(b"another's"))
    assert late.read_bytes() == b"another's"


@pytest.mark.parametrize(
    "wrong",
    [{"seed": "3"}, {"urdf": None}, {"created_utc": "today"}, {"extra": {"a": 1}}, {"extra": {1: "a"}}],
)
def test_metadata_is_checked_before_anything_is_written(wrong):
    with pytest.raises(InputError, match="metadata"):
        SessionMetadata(**wrong)


def test_extra_metadata_cannot_replace_the_header(tmp_path):
    metadata = SessionMetadata(urdf="true", extra={"urdf": "false", "format_version": "9"})
    path = write_session(tmp_path / "s", [], metadata)
    assert Session.open(path).metadata == metadata
    assert EXTRA_RECORD.encode() in path.read_bytes()


def test_growing_session_is_followed_without_reading_twice(tmp_path, whole):
    path, seen = tmp_path / "s.mcap", []
    follower = SessionTail(path, "tick", last=10_000)
    for part in np.linspace(0, len(whole), 9).astype(int)[1:]:
        before = follower._file.read_bytes
        path.write_bytes(bytes(before) + whole[before:part])  # what was read once is gone
        found = follower.read()
        assert found is None or len(found)
        seen.append(0 if found is None else len(found))
        assert follower.complete == (part == len(whole))
    assert sorted(seen) == seen
    assert 0 < seen[3] < seen[-1] == follower.count == 1500
    assert_ticks(found, range(1500))
    with pytest.raises(SessionError, match=r"gone\.mcap: cannot be read: No such file"):
        SessionTail(tmp_path / "gone.mcap", "tick", last=1).read()
    short = SessionTail(path, "tick", last=100)
    path.write_bytes(whole)
    assert_ticks(short.read(), range(1400, 1500))
    none = {"time_s": np.zeros(0), "x": np.zeros(0)}
    empty = write_session(tmp_path / "empty.mcap", [(SLOW, none)], METADATA)
    assert SessionTail(empty, "slow", last=1).read() is None


def test_chunks_of_any_order_are_read_in_the_order_of_logging(tmp_path):
    formed = WireFormat(SLOW).encode(SLOW.records({"time_s": np.arange(6.0), "x": np.zeros(6)}))
    with (tmp_path / "s.mcap").open("wb") as file:
        mcap = Writer(file, chunk_size=1, compression=CompressionType.LZ4)  # a chunk for each message
        mcap.start()
        mcap.add_metadata(HEADER_RECORD, {"format_version": "1", "streams": streams_to_json((SLOW,))})
        channel = mcap.register_channel("slow", "protobuf", mcap.register_schema("x", "protobuf", b""))
        for number in (4, 5, 0, 2, 1, 3):
            mcap.add_message(channel, number, formed[number], number, sequence=number)
        mcap.finish()
    session = Session.open(tmp_path / "s.mcap")
    assert session.samples("slow")["time_s"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert session.dropped == 0


def test_long_session_opens_with_little_more_memory_than_its_columns(tmp_path):
    """Neither the file nor its messages are held beside the columns."""
    count = 100_000
    stream = Stream("wide", (Column("time_s", "s"), Column("x", "m", 20)))
    values = np.random.default_rng(0).normal(size=(count, 20))
    path = write_session(
        tmp_path / "s", [(stream, {"time_s": np.arange(count) / 1e3, "x": values})], METADATA
    )
    tracemalloc.start()
    session = Session.open(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(session.samples("wide")["x"], values)
    assert peak < 2.5 * values.nbytes  # with them, it would be four times as much


def test_only_the_chosen_columns_are_kept_unchanged(tmp_path):
    path = write_session(tmp_path / "s", [(SLOW, {"time_s": [0.0, 1.0], "x": [2.0, 3.0]})], METADATA)
    session = Session.open(path)
    less = session.read_columns("slow", {"time_s", "unknown"})
    assert list(less.samples("slow")) == ["time_s"]
    assert less.samples("slow")["time_s"].tolist() == [0.0, 1.0]
    assert session.read_columns("other", {"x"}) is session
