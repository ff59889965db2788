"""Sessions that were damaged byte by byte, and whole ones by somebody who means no good."""

import csv
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from control.probing.plan import ProbingPlan
from files_under_fire.case import Case, Rng, pick
from files_under_fire.hostile import TEXTS, URDFS
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from robot_io import Session, Stream, write_session
from sim_backend.scenario import Scenario

Columns = dict[str, np.ndarray[Any, Any]]
NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e31, 5e-324, -0.0, 1e18)
COMMANDS = (
    ["info"],
    ["estimate"],
    ["compare"],
    ["export", "--stream", "tick", "-o", "out.csv"],
    ["inspect", "--save", "out.rrd"],
    ["info", "--json"],
    ["estimate", "--json"],
)


@cache
def whole() -> bytes:
    """A short probing of the simulated arm."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s.mcap"
        plan = ProbingPlan(repeats=1, hold_s=0.1)
        run_probing(ProbingJob(find_robot(DEFAULT), path, plan, scenario=Scenario(), seed=1, online=None))
        return path.read_bytes()


def case(folder: Path, rng: Rng) -> Case:
    """A damaged session and a command for it."""
    path, good = folder / "s.mcap", folder / "good.mcap"
    good.write_bytes(whole())
    session = Session.open(good)
    kind = pick(rng, tuple(_DAMAGES))
    expected = _DAMAGES[kind](path, session, rng)
    command, *options = pick(rng, COMMANDS)
    options = [str(folder / word) if word.startswith("out.") else word for word in options]
    out = folder / "out.csv"
    return Case(
        f"{kind}, {command}",
        [command, str(path), *options],
        lambda: _differs(path, expected) or (_exported(out, expected) if out.exists() else ""),
    )


def _differs(path: Path, expected: Columns | None) -> str:
    """Which column is neither what was written, nor the beginning of it; empty if none is."""
    if expected is None:
        return ""
    read = Session.open(path).samples("tick")
    for name in read:
        if name not in expected or not np.array_equal(
            read[name], expected[name][: len(read)], equal_nan=read[name].dtype.kind == "f"
        ):
            return f"column '{name}' was read as something else"
    return ""


def _exported(table: Path, expected: Columns | None) -> str:
    """Which column of a table of ticks is neither what was written, nor the beginning of it."""
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for name in rows[0] if rows and expected else ():
        plain = name.rpartition("_")[0] if name not in expected else name
        if plain not in expected:
            return f"column '{name}' was made up"
        values = expected[plain][: len(rows)].reshape(len(rows), -1)
        if values.dtype.kind not in "fiu" or name == "phase":
            continue
        read = np.array([float(row[name] or "nan") for row in rows])
        if not any(np.array_equal(read, one.astype(float), equal_nan=True) for one in values.T):
            return f"column '{name}' was exported as something else"
    return ""


def _bytes(change: Callable[[bytearray, Rng], None]) -> Callable[[Path, Session, Rng], Columns | None]:
    def damage(path: Path, session: Session, rng: Rng) -> Columns | None:
        data = bytearray(whole())
        change(data, rng)
        path.write_bytes(data)
        return dict(session.samples("tick").columns)

    return damage


def _flip(data: bytearray, rng: Rng) -> None:
    for place in rng.integers(len(data), size=int(rng.integers(1, 20))):
        data[place] ^= 1 << int(rng.integers(8))


def _cut(data: bytearray, rng: Rng) -> None:
    del data[int(rng.integers(len(data))) :]


def _move(data: bytearray, rng: Rng) -> None:
    (start, end), to = np.sort(rng.integers(len(data), size=2)), int(rng.integers(len(data)))
    data[to:to] = data[start : min(end, start + 100_000)]


def _drop(data: bytearray, rng: Rng) -> None:
    start = int(rng.integers(len(data)))
    del data[start : start + int(rng.integers(1, 5000))]


def _lengths(data: bytearray, rng: Rng) -> None:
    """Numbers that may be lengths are made large."""
    for place in rng.integers(len(data) - 8, size=5):
        data[place : place + 8] = int(rng.integers(2**62)).to_bytes(8, "little")


def _columns(change: Callable[[Columns, Rng], None]) -> Callable[[Path, Session, Rng], Columns | None]:
    def damage(path: Path, session: Session, rng: Rng) -> Columns | None:
        samples = session.samples("tick")
        columns = {name: samples[name].copy() for name in samples}
        change(columns, rng)
        kept = [one for one in samples.stream.columns if one.name in columns]
        made = [
            replace(one, width=columns[one.name].shape[1] if columns[one.name].ndim > 1 else 1)
            for one in kept
        ]
        write_session(path, [(Stream("tick", tuple(made)), columns)], session.metadata, session.events)
        return columns

    return damage


def _odd_numbers(columns: Columns, rng: Rng) -> None:
    for name in rng.choice([one for one in columns if columns[one].dtype.kind == "f"], 2):
        rows = rng.integers(len(columns[name]), size=int(rng.integers(1, 50)))
        columns[name][rows] = pick(rng, NUMBERS)


def _odd_times(columns: Columns, rng: Rng) -> None:
    time_s = columns["time_s"]
    columns["time_s"] = pick(
        rng, (time_s[::-1], 0 * time_s, -time_s, time_s * 1e9, time_s * 1e-12, time_s + 1e15, time_s // 0.1)
    ).copy()


def _odd_runs(columns: Columns, rng: Rng) -> None:
    count = len(columns["run"])
    some = (np.arange(count), -np.ones(count), np.full(count, 2**31 - 1), rng.integers(-5, 5, count))
    columns["run"] = np.asarray(pick(rng, some)).astype(columns["run"].dtype)


def _odd_phases(columns: Columns, rng: Rng) -> None:
    columns["phase"] = rng.integers(-100, 100, len(columns["phase"])).astype(columns["phase"].dtype)


def _few(columns: Columns, rng: Rng) -> None:
    count = int(pick(rng, (0, 1, 2, 5, 40)))
    columns.update({name: values[:count] for name, values in columns.items()})


def _without(columns: Columns, rng: Rng) -> None:
    for name in rng.choice([one for one in columns if one != "time_s"], 3, replace=False):
        del columns[name]


def _exchanged(columns: Columns, rng: Rng) -> None:
    one, other = rng.choice([name for name in columns if columns[name].dtype.kind == "f"], 2)
    if columns[one].shape == columns[other].shape:
        columns[one], columns[other] = columns[other], columns[one]


def _still(columns: Columns, rng: Rng) -> None:
    for name in rng.choice([one for one in columns if one != "time_s"], 4, replace=False):
        columns[name][:] = columns[name][0]


def _narrow(columns: Columns, rng: Rng) -> None:
    wide = [name for name in columns if columns[name].ndim > 1]
    columns.update({name: columns[name][:, :2] for name in rng.choice(wide, 2)})


def _metadata(path: Path, session: Session, rng: Rng) -> Columns | None:
    samples = session.samples("tick")
    field = pick(rng, ("robot_file", "urdf", "calibration", "scenario", "command_line", "extra"))
    text = pick(rng, URDFS if field == "urdf" else TEXTS)
    value = {text[:60]: text, "run_labels": text, "plan": text} if field == "extra" else text
    metadata = replace(session.metadata, **{field: value})
    write_session(path, [(samples.stream, dict(samples.columns))], metadata, session.events)
    return dict(samples.columns)


def _messages(path: Path, session: Session, rng: Rng) -> Columns | None:
    """Whole by its checksums, but some messages or the header are not what they should be."""
    del session
    reader, wrong = make_reader(BytesIO(whole())), set(rng.integers(5000, size=3).tolist())
    with path.open("wb") as file:
        writer, channels = Writer(file, chunk_size=60_000), dict[int, int]()
        writer.start(profile="palpate")
        for record in reader.iter_metadata():
            fields = {key: _spoilt(text, rng) for key, text in record.metadata.items()}
            writer.add_metadata(record.name, fields)
        for number, (schema, channel, message) in enumerate(reader.iter_messages()):
            if channel.id not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "protobuf", known)
            data = bytearray(message.data)
            if number in wrong:
                pick(rng, (_flip, _cut, _drop))(data, rng)
            writer.add_message(channels[channel.id], message.log_time, bytes(data), 0, message.sequence)
        writer.finish()
    return None


def _spoilt(text: str, rng: Rng) -> str:
    if rng.random() < 0.8 or not text:
        return text
    place = int(rng.integers(len(text)))
    return (
        text[:place]
        + pick(rng, ("", "9" * 30, "[", '"', "null", "\x1b[2J", "-1", "1e999"))
        + text[place + 1 :]
    )


_DAMAGES: dict[str, Callable[[Path, Session, Rng], Columns | None]] = {
    "bits flipped": _bytes(_flip),
    "cut off": _bytes(_cut),
    "a part twice": _bytes(_move),
    "a part missing": _bytes(_drop),
    "lengths": _bytes(_lengths),
    "odd numbers": _columns(_odd_numbers),
    "odd times": _columns(_odd_times),
    "odd runs": _columns(_odd_runs),
    "odd phases": _columns(_odd_phases),
    "few rows": _columns(_few),
    "columns missing": _columns(_without),
    "columns exchanged": _columns(_exchanged),
    "nothing moves": _columns(_still),
    "columns too narrow": _columns(_narrow),
    "texts": _metadata,
    "messages": _messages,
}
