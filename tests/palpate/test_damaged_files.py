"""Commands on damaged and hostile files end, refuse in one line, and read no wrong number."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.robot_io import Session, Stream, write_session
from palpate.runs.robots import DEFAULT, find_robot
from palpate.sim_backend.scenario import Scenario
from tests.palpate.cli import run
from tests.palpate.sessions import QUICK, cut

many = settings(  # each of them is a command or two
    max_examples=settings.default.max_examples // 2,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)

NAMES = ("time_s", "displacement_m", "force_N")
CELLS = (
    *("nan", "inf", "-inf", "1e400", "-1e400", "1e-400", "0x10", "1_000", "\u0661\u0662", "\uff11\uff12"),
    *("+-1", "", " ", "--", "1.2.3", "1,5", "1e", "\u221e", "NULL", "-0", "1d5", "true", "1e30", "1e200"),
    *("9" * 400, "\x1b[2J"),
)
NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e31, 5e-324, -0.0, 1e18)
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
TEXTS = (
    *("", " ", "\x1b[2J[/red]", "null", "[]", "3", "a: b: c", "{", "[" * 20_000, "{a: " * 5_000, BOMB),
    *("!!python/object/apply:os.system ['false']", "&a [*a]", "k: 1\nk: 2\n", "\ufeffname: x", "1e999"),
    *("name: \u202eabc\u0000", "name: " + "x" * 2_000_000, "\t- a", "<<: *x", '{"0": 5, "x": []}'),
    "? [a, b]\n: c\n",
)
VALUES = (
    *(None, "", -1, 0, 1e999, float("nan"), 10**30, "x" * 5000, [], {}, [[]], True, "\x1b[2J", 1e-300),
    *("1,5", "../.."),
)
LINK = (
    '<link name="{}"><inertial><mass value="{}"/>'
    '<inertia ixx="{}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)
MESH = '<link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'


def chain(count, mass="1", inertia="1", kind="revolute"):
    """A URDF with so many joints in a row."""
    links = "".join(LINK.format(f"l{n}", mass, inertia) for n in range(count + 1))
    joints = "".join(JOINT.format(f"j{n}", f"l{n}", f"l{n + 1}", kind) for n in range(count))
    return f'<robot name="r">{links}{joints}</robot>'


URDFS = (
    *TEXTS,
    *("<robot", "<robot/>", "<robot name='r'><link name='a'/><link name='a'/></robot>", "<a>" * 5000),
    '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>',
    '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>',
    chain(1).replace("</robot>", JOINT.format("k", "l1", "l0", "revolute") + "</robot>"),  # a cycle
    *(chain(1), chain(3), chain(3000), chain(2, mass="0"), chain(3, mass="-1"), chain(3, mass="nan")),
    *(chain(3, mass="1e999"), chain(3, inertia="1,5"), chain(3, inertia="-1"), chain(3, inertia="inf")),
    *(chain(3, kind="prismatic"), chain(3, kind="floating"), chain(3, kind="\x1b[2J")),
    *(
        f'<robot name="r">{MESH.format(name)}</robot>'
        for name in ("file:///etc/passwd", "/dev/zero", "http://127.0.0.1:9/x.stl")
    ),
)


def ends_well(*arguments):
    """Run a command; it must end with a documented exit code and at most one plain line."""
    result = run(*arguments)
    assert result.exit_code in {0, 1, 2, 3}, (arguments, result.exception, result.stderr[-300:])
    if result.exit_code:
        assert isinstance(result.exception, SystemExit), (arguments, result.exception)
        refusals = [line for line in result.stderr.splitlines() if line.startswith("palpate: ")]
        assert len(refusals) == 1, (arguments, result.stderr[-300:])
    assert "Traceback" not in result.stderr
    assert "internal error" not in result.stderr
    assert "\x1b" not in result.stderr
    return result.exit_code == 0


@st.composite
def degenerate_tables(draw):
    """Two short presses at 100 Hz, with something wrong in them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    time_s = np.arange(240) * 0.01
    depth_m = 0.004 * np.sin(2 * np.pi * time_s / 1.2) + 1e-6 * rng.standard_normal(240)
    force_n = np.maximum(500 * depth_m, 0.0) + 0.01 * rng.standard_normal(240)
    values = (time_s.round(3), depth_m.round(7), force_n.round(4))
    columns = {name: column.tolist() for name, column in zip(NAMES, values, strict=True)}
    name, other = draw(st.sampled_from(NAMES)), draw(st.sampled_from(NAMES))
    match draw(st.sampled_from(["cells", "scaled", "shifted", "rounded", "rows", "same", "runs", "more"])):
        case "cells":
            cell, count = draw(st.sampled_from(CELLS)), draw(st.sampled_from([1, 3, 50, 240]))
            for row in rng.permutation(240)[:count]:
                columns[name][row] = cell
        case "scaled":
            factor = draw(st.sampled_from([0.0, 1e300, 1e-300, 1e-310, -1.0, 1e9, 1e-9, 1e30, 1e155]))
            columns[name] = [factor * value for value in columns[name]]
        case "shifted":
            shift = draw(st.sampled_from([1e9, -1e9, 1e16, 1e-5, -5.0, 1e300]))
            columns[name] = [shift + value for value in columns[name]]
        case "rounded":
            digits = draw(st.integers(-1, 3))
            columns[name] = [round(value, digits) for value in columns[name]]
        case "rows":
            orders = (
                np.arange(draw(st.sampled_from([0, 1, 2, 4, 5, 6, 10, 20]))),
                rng.permutation(240),
                np.arange(240)[::-1],
                np.repeat(np.arange(240), 2),
            )
            rows = orders[draw(st.integers(0, 3))]
            columns = {key: [values[row] for row in rows] for key, values in columns.items()}
        case "same":
            columns[name] = list(columns[other])
        case "runs":
            runs = (range(240), [7] * 240, ["a", "b"] * 120, [""] * 240, [10**30] * 240, [math.nan] * 240)
            columns["run"] = list(runs[draw(st.integers(0, 5))])
        case "more":
            name = draw(st.sampled_from(["velocity_m_s", "acceleration_m_s2", "phase", "temperature"]))
            columns[name] = rng.standard_normal(240).tolist()
    return columns


def write_csv(path, columns):
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def number(cell):
    """The number in a cell; NaN for everything else."""
    try:
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


@many
@given(columns=degenerate_tables())
def test_degenerate_table_is_imported_faithfully(tmp_path, columns):
    path, session = tmp_path / "a.csv", tmp_path / "a.mcap"
    session.unlink(missing_ok=True)
    write_csv(path, columns)
    if not ends_well("import", path, "-o", session):
        return
    with path.open(newline="", encoding="utf-8") as file:
        rows = sorted(csv.DictReader(file), key=lambda row: row.get("run", ""))  # a run is stored together
    rows = [row for row in rows if np.isfinite([number(row[name] or "") for name in NAMES]).all()]
    stored = Session.open(session).samples("contact")
    for name, column in zip(NAMES, ("time_s", "displacement_m", "force_n"), strict=True):
        numbers = [number(row[name]) for row in rows]
        if column == "displacement_m":  # counted from where the force begins
            rounding = 4.0 * np.finfo(float).eps * np.max(np.abs(numbers))
            moved, expected = (np.abs(x - np.asarray(x)[0]) for x in (stored[column], numbers))
            np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=rounding)
        else:  # rows that repeat a time are spread up to the next one
            own = np.append(True, np.diff(numbers) != 0.0) | (name != NAMES[0])
            np.testing.assert_allclose(np.abs(stored[column])[own], np.abs(numbers)[own], rtol=1e-12)


@many
@given(
    columns=degenerate_tables(),
    command=st.sampled_from(["estimate", "compare", "diagnose"]),
    kind=st.sampled_from(["f8", "f4", "f2", "U30", "c16", "parquet"]),
)
def test_degenerate_array_is_analyzed_or_refused(tmp_path, few_effects, columns, command, kind):
    path = tmp_path / ("a.parquet" if kind == "parquet" else "a.npz")
    try:
        with np.errstate(all="ignore"):
            arrays = {name: np.array(values).astype("f8") for name, values in columns.items()}
            arrays = {
                name: array if kind == "parquet" else array.astype(kind) for name, array in arrays.items()
            }
    except (ValueError, OverflowError):
        arrays = {name: np.array([str(value) for value in values]) for name, values in columns.items()}
    if kind == "parquet":
        pa.parquet.write_table(pa.table(arrays), path)
    else:
        np.savez(path, **arrays)
    ends_well(command, path, "--model", "kelvin_voigt")


def damaged(data, draw):
    """Bytes of a file with bits flipped, a part cut off, missing or twice, or lengths made large."""
    place, size = draw(st.integers(0, len(data) - 9)), draw(st.integers(1, 5000))
    match draw(st.sampled_from(["flip", "cut", "twice", "drop", "length"])):
        case "flip":
            for at in draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=20)):
                data[at] ^= 1 << draw(st.integers(0, 7))
        case "cut":
            del data[place:]
        case "twice":
            data[place:place] = data[size : size + 100_000]
        case "drop":
            del data[place : place + size]
        case "length":
            data[place : place + 8] = draw(st.integers(0, 2**62)).to_bytes(8, "little")
    return bytes(data)


def spoilt(columns, draw):
    """Ticks whose numbers are odd, few, exchanged, constant, too narrow or missing."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    names = sorted(set(columns) - {"time_s"})
    floats, count = [name for name in names if columns[name].dtype.kind == "f"], len(columns["run"])
    first, second = rng.choice(floats, 2, replace=False)
    match draw(
        st.sampled_from(["numbers", "times", "runs", "phases", "few", "less", "mixed", "still", "narrow"])
    ):
        case "numbers":
            columns[first][rng.integers(count, size=20)] = draw(st.sampled_from(NUMBERS))
        case "times":
            t = columns["time_s"]
            odd = (t[::-1], 0 * t, -t, t * 1e9, t * 1e-12, t + 1e15, t // 0.1)
            columns["time_s"] = odd[draw(st.integers(0, 6))].copy()
        case "runs":
            odd = (np.arange(count), -np.ones(count), np.full(count, 2**31 - 1), rng.integers(-5, 5, count))
            columns["run"] = odd[draw(st.integers(0, 3))].astype(columns["run"].dtype)
        case "phases":
            columns["phase"] = rng.integers(-100, 100, count).astype(columns["phase"].dtype)
        case "few":
            few = draw(st.sampled_from([0, 1, 2, 5, 40]))
            columns = {name: values[:few] for name, values in columns.items()}
        case "less":
            for name in rng.choice(names, 3, replace=False):
                del columns[name]
        case "mixed" if columns[first].shape == columns[second].shape:
            columns[first], columns[second] = columns[second], columns[first]
        case "still":
            for name in rng.choice(names, 4, replace=False):
                columns[name][:] = columns[name][0]
        case "narrow":
            wide = [name for name in names if columns[name].ndim > 1]
            columns |= {name: columns[name][:, :2] for name in rng.choice(wide, 2)}
    return columns


@pytest.fixture(scope="module")
def short(probed, tmp_path_factory):
    """A session of one run."""
    return cut(probed[0], tmp_path_factory.mktemp("short") / "short.mcap", 0.3)


@many
@given(
    data=st.data(),
    kind=st.sampled_from(["bytes", "bytes", "columns", "columns", "texts"]),
    command=st.sampled_from(
        [
            "info",
            "estimate",
            "compare",
            "info --json",
            "estimate --json",
            "export --stream tick -o",
            "inspect --save",
        ]
    ),
)
def test_damaged_session_is_read_as_written_or_refused(tmp_path, short, data, kind, command):
    good, path = Session.open(short), tmp_path / "s.mcap"
    samples = good.samples("tick")
    columns = {name: samples[name].copy() for name in samples}
    metadata, stream = good.metadata, samples.stream
    path.unlink(missing_ok=True)
    if kind == "bytes":
        path.write_bytes(damaged(bytearray(short.read_bytes()), data.draw))
    else:
        if kind == "columns":
            columns = spoilt(columns, data.draw)
            kept = [column for column in stream.columns if column.name in columns]
            widths = [columns[c.name].shape[1] if columns[c.name].ndim > 1 else 1 for c in kept]
            made = [replace(column, width=width) for column, width in zip(kept, widths, strict=True)]
            stream = Stream("tick", tuple(made))
        else:
            fields = ("robot_file", "urdf", "calibration", "scenario", "command_line", "extra")
            field = data.draw(st.sampled_from(fields))
            text = data.draw(st.sampled_from(URDFS if field == "urdf" else TEXTS))
            value = {text[:60]: text, "run_labels": text, "plan": text} if field == "extra" else text
            metadata = replace(metadata, **{field: value})
        write_session(path, [(stream, columns)], metadata, good.events)
    *words, last = command.split()
    out = {"-o": [tmp_path / "out.csv"], "--save": [tmp_path / "out.rrd"]}.get(last, [])
    if ends_well(*words[:1] or [last], path, *([*words[1:], last] if words else []), *out):
        read = Session.open(path).samples("tick")
        for name in read:
            np.testing.assert_array_equal(read[name], columns[name][: len(read)], err_msg=name)


def places(tree):
    """Every place in nested lists and mappings: what holds it, and its key there."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from places(tree[key])


def good_tree(option):
    """What a good file for this option of `palpate probe` holds."""
    if option == "--robot":
        document = find_robot(DEFAULT).document
        tree = yaml.safe_load(document.text)
        return tree | {key: str(Path(document.origin).parent / tree[key]) for key in ("urdf", "dh")}
    if option == "--scenario":
        return Scenario().model_dump(mode="json")
    if option == "--experiment":
        return yaml.safe_load(QUICK.read_text()) | {"force_limit_n": 5.0, "repeats": 1}
    friction = {"effect": "coulomb_friction", "joint": 1, "coulomb_nm": 0.2}
    return {"hidden": [friction, {"effect": "drift", "channel": "contact"}]}


@many
@given(data=st.data(), option=st.sampled_from(["--robot", "--scenario", "--experiment", "--hidden"]))
def test_wrong_or_hostile_file_is_used_or_refused(tmp_path, log_in_process, data, option):
    path = tmp_path / "file.yaml"
    if data.draw(st.booleans()):
        tree = good_tree(option)
        holder, key = data.draw(st.sampled_from(list(places(tree))))
        match data.draw(st.sampled_from(["value", "value", "value", "missing", "key"])):
            case "missing":
                del holder[key]
            case "key" if isinstance(holder, dict):
                holder[data.draw(st.sampled_from(["unknown", "\x1b[2J", 3, "<<"]))] = 1
            case _:
                holder[key] = data.draw(st.sampled_from(VALUES))
        text = yaml.safe_dump(tree)
    else:
        text = data.draw(st.sampled_from(TEXTS))
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    quick = [] if option == "--experiment" else ["--experiment", QUICK, "--online", "none"]
    session = tmp_path / "s.mcap"
    session.unlink(missing_ok=True)
    ends_well("probe", option, path, *quick, "-o", session)


@pytest.mark.parametrize("number", range(len(URDFS)))
def test_hostile_urdf_is_used_or_refused(tmp_path, number):
    path, table = tmp_path / "arm.urdf", tmp_path / "joint.csv"
    path.write_text(URDFS[number], encoding="utf-8", errors="surrogatepass")
    t = np.arange(400) * 0.01
    write_csv(table, {"time_s": t, "position_rad": np.sin(5 * t), "torque_Nm": np.cos(5 * t)})
    ends_well("estimate", table, "--model", "rigid_body", "--urdf", path)
