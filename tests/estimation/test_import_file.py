import gzip
import re
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import gaussian_filter1d

from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data import file_columns
from palpate.estimation.data.channels import import_streams
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import import_files
from palpate.estimation.data.import_options import ImportOptions, parse_pairs
from palpate.estimation.data.measured_derivatives import is_difference
from palpate.estimation.data.table import read_table
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from palpate.robot_io.files import atomic_write
from palpate.robot_io.session import SessionMetadata, write_session
from tests.estimation.press_tables import refusal
from tests.files import write_csv

T = np.arange(50) * 0.01
X = 0.002 + 0.001 * np.sin(9 * T)
F = 500 * X
PRESS = {"time_s": T, "displacement_m": X, "force_N": F}


@pytest.fixture
def contact(tmp_path):
    """Writes a contact file with changed or added columns; None removes one."""
    return lambda **changed: write_csv(tmp_path / "data.csv", PRESS | changed)


def only(imported):
    (channel,) = imported.channels
    return channel


def test_contact(contact):
    channel = only(import_file(contact()))
    assert (channel.name, channel.kind) == ("contact", ChannelKind.CONTACT)
    np.testing.assert_allclose(channel.position, X)
    np.testing.assert_allclose(channel.effort, F)
    np.testing.assert_allclose(channel.velocity, 0.009 * np.cos(9 * T), atol=2e-5)
    np.testing.assert_allclose(channel.acceleration[5:-5], -0.081 * np.sin(9 * T)[5:-5], atol=2e-3)
    moving_in = np.cos(9 * T) > 0.0
    sure = np.abs(np.cos(9 * T)) > 0.2
    np.testing.assert_array_equal(
        channel.phase[sure], np.where(moving_in, Phase.LOADING, Phase.UNLOADING)[sure]
    )
    assert channel.surface is None


def test_joints(tmp_path):
    columns = {"time_s": T, "position_1_rad": X, "torque_1_Nm": F, "position_2_rad": -X, "torque_2_Nm": 2 * F}
    first, second = import_file(write_csv(tmp_path / "arm.csv", columns)).channels
    assert (first.name, second.name) == ("joint_1", "joint_2")
    assert second.kind is ChannelKind.REVOLUTE
    np.testing.assert_allclose(second.effort, 2 * F)
    np.testing.assert_allclose(first.context["joint_position"], np.column_stack([X, -X]))


def test_all_formats_hold_the_same(tmp_path, contact):
    csv = contact()
    packed = tmp_path / "data.csv.gz"
    packed.write_bytes(gzip.compress(csv.read_bytes()))
    parquet, npz = tmp_path / "data.parquet", tmp_path / "data.npz"
    pa.parquet.write_table(pa.table(PRESS), parquet)
    np.savez(npz, **PRESS, angle_deg=30.0, rate=100.0)  # of the specimen and the sensor, not of a sample
    matrices = tmp_path / "wide.npz"  # such as one row per run
    np.savez(matrices, time_s=[T], displacement_m=[X], force_N=[F])
    names = [f"{what}_1_{unit}" for what, unit in (("time", "s"), ("displacement", "m"), ("force", "N"))]
    assert read_table(matrices).names == tuple(names)
    semicolons = write_csv(tmp_path / "e.csv", PRESS, ";")
    tabs = write_csv(tmp_path / "e.tsv", PRESS, "\t")
    expected = only(import_file(csv))
    for path in (packed, parquet, npz, semicolons, tabs):
        channel = only(import_file(path))
        for what in ("time_s", "position", "velocity", "acceleration", "effort", "run"):
            np.testing.assert_array_equal(getattr(channel, what), getattr(expected, what))
    assert open_source(csv).channels[0].name == "contact"


def test_columns_of_other_names_and_units(tmp_path):
    path = write_csv(tmp_path / "own.csv", {"t": 1e3 * T, "indent_mm": 1e3 * X, "load": 1e3 * F})
    options = ImportOptions(
        columns={"time": "t", "displacement_m": "indent_mm", "force_N": "load"},
        units={"time": "ms", "load": "mN"},
    )
    channel = only(import_file(path, options))
    np.testing.assert_allclose(channel.time_s, T, atol=1e-12)
    np.testing.assert_allclose(channel.position, X)  # the column's own name says mm
    np.testing.assert_allclose(channel.effort, F)


@pytest.mark.parametrize(("quantity", "units"), [("displacement_m", {}), ("depth", {"displacement": "m"})])
def test_unit_of_another_dimension_is_kept_and_reported(tmp_path, quantity, units):
    path = write_csv(tmp_path / "cell.csv", {"time_s": T, "weight_N": F, "force_N": F})
    imported = import_file(path, ImportOptions(columns={quantity: "weight_N"}, units=units))
    np.testing.assert_allclose(only(imported).position, F)
    assert "'weight_N' is read as displacement in m" in imported.notes[1]


def test_numbered_runs_keep_their_numbers_and_are_grouped(contact):
    channel = only(import_file(contact(run=np.tile([7, 3], 25))))
    np.testing.assert_array_equal(channel.run, [3] * 25 + [7] * 25)
    np.testing.assert_allclose(channel.time_s[:25], T[1::2])


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (("b", "a"), {0: "b", 1: "a"}),  # text gets numbers in order of appearance
        (("07", "12"), {7: "07", 12: "12"}),
        (("12345678901234567890", "7"), {0: "12345678901234567890", 1: "7"}),  # more than fits into 64 bits
    ],
)
def test_runs_are_called_by_number_or_name(contact, names, labels):
    time_s = np.concatenate([T[:20], T[:30]])
    imported = import_file(contact(run=[names[0]] * 20 + [names[1]] * 30, time_s=time_s))
    assert imported.run_labels == labels
    np.testing.assert_array_equal(only(imported).run, np.repeat(list(labels), [20, 30]))


@pytest.mark.parametrize("names", [("1", "01", "001"), ("x" * 70 + "1", "x" * 70 + "2", "x" * 70)])
def test_runs_of_different_names_are_different_runs(names, contact):
    path = contact(run=[name for name in names for _ in range(10)] + [names[0]] * 20)
    assert import_file(path).run_labels == dict(enumerate(names))
    for name, rows in zip(names, (30, 10, 10), strict=True):
        assert len(only(import_file(path, ImportOptions(where={"run": name})))) == rows


def test_derivatives_stay_within_runs_and_given_ones_are_preserved(contact):
    x = np.where(np.arange(50) < 25, 0.001, 0.05)
    channel = only(import_file(contact(run=[0] * 25 + [1] * 25, displacement_m=x)))
    np.testing.assert_allclose(channel.velocity, 0.0, atol=1e-12)
    channel = only(import_file(contact(phase=["loading"] * 25 + ["4"] * 25)))
    np.testing.assert_array_equal(channel.phase, [Phase.LOADING] * 25 + [Phase.HOLD] * 25)
    velocity = 0.009 * np.cos(9 * T)
    channel = only(import_file(contact(velocity_mm_s=1e3 * velocity, acceleration_m_s2=np.full(50, 0.5))))
    np.testing.assert_allclose(channel.velocity, velocity)
    np.testing.assert_allclose(channel.acceleration, 0.5)


@pytest.mark.parametrize("derive", ["gradient", "backward", "tachometer"])
def test_velocity_from_position_differences_is_derived_again(tmp_path, derive):
    rng = np.random.default_rng(4)
    time_s = np.arange(2000) * 2e-3
    read = np.round(np.sin(3.0 * time_s) / 4e-4) * 4e-4  # an encoder of 14 bits
    velocity = {
        "gradient": np.gradient(read, time_s),
        "backward": np.diff(read, prepend=read[0]) / 2e-3,
        "tachometer": 3.0 * np.cos(3.0 * time_s) + 0.05 * rng.standard_normal(2000),
    }[derive]
    columns = {"time_s": time_s, "position_rad": read, "velocity_rad_s": velocity, "torque_Nm": velocity}
    found = import_file(write_csv(tmp_path / "turns.csv", columns))
    (joint,) = found.channels
    if derive == "tachometer":
        assert np.array_equal(joint.velocity, velocity)
        assert not found.notes
    else:
        error = joint.velocity - 3.0 * np.cos(3.0 * time_s)
        assert np.std(error) < 0.2 * np.std(velocity - 3.0 * np.cos(3.0 * time_s))
        assert "column 'velocity_rad_s' holds differences" in found.notes[0]


@pytest.mark.parametrize("integrate", [True, False])
def test_speed_whose_integral_is_the_position_is_no_difference(integrate):
    time_s, run = np.arange(500) * 8e-3, np.zeros(500, dtype=np.int64)
    speed = np.sin(2.0 * np.pi * time_s * (25.0 - 2.0 * time_s))  # five samples a period
    position = cumulative_trapezoid(speed, time_s, initial=0.0)
    column = speed if integrate else np.gradient(position, time_s)
    smooth = np.zeros(500)  # windows that are wider than a period
    assert is_difference(time_s, position, column, smooth, run) is not integrate


def test_where_option_selects_rows_and_context_keeps_signals(contact):
    path = contact(specimen=["P1"] * 30 + ["P2"] * 20, temperature_C=20 + T)
    channel = only(import_file(path, ImportOptions(where={"specimen": "P1"}, context=("temperature_C",))))
    assert len(channel) == 30
    np.testing.assert_allclose(channel.context["temperature_C"], 20 + T[:30])


def test_context_column_named_like_a_signal_of_palpate_is_kept_beside_it(contact):
    column = "load"
    path = contact(**{column: 20 + T})
    assert import_file(path).unused == (column,)
    imported = import_file(path, ImportOptions(context=(column,)))
    channel = only(imported)
    np.testing.assert_allclose(channel.context[f"recorded_{column}"], 20 + T)
    assert channel.recorded == {f"recorded_{column}"}
    assert any(f"'{column}' is kept as the signal recorded_{column}" in note for note in imported.notes)


@pytest.mark.parametrize("column", ["température à l'air", "a" * 80])
def test_session_keeps_a_context_for_any_column_name(contact, tmp_path, column):
    imported = import_file(contact(**{column: 20 + T}), ImportOptions(context=(column,)))
    place = tmp_path / "kept.mcap"
    write_session(place, import_streams(imported), SessionMetadata(), ())
    (after,) = open_source(place).channels
    (signal,) = after.recorded
    np.testing.assert_allclose(after.context[signal], 20 + T)


def test_unused_columns_are_reported_including_an_angle_without_unit(contact):
    path = contact(specimen=["P1"] * 50, temperature_C=20 + T, humidity=40 + T, tool=np.full(50, 3.0))
    assert import_file(path).unused == ("temperature_C", "humidity")
    assert import_file(path, ImportOptions(context=("humidity",))).unused == ("temperature_C",)
    assert import_file(contact(angle=T)).unused == ("angle",)


def outcome(path):
    """The channels, or the line that refuses the file."""
    try:
        return import_file(path).channels
    except InputError as error:
        return str(error)


@given(st.text(max_size=400), st.sampled_from([".csv", ".tsv", ".csv.gz", ".npz", ".parquet"]))
def test_any_text_gives_channels_or_one_clear_line(tmp_path_factory, text, ending):
    path = tmp_path_factory.mktemp("any") / f"any{ending}"
    data = text.encode()
    path.write_bytes(gzip.compress(data) if ending.endswith("gz") else data)
    found = outcome(path)
    assert isinstance(found, tuple) or (len(found) < 1000 and "\n" not in found)


cell = st.one_of(st.floats(allow_nan=True, width=32), st.just(""), st.just("x"), st.integers(-5, 5))


@given(st.lists(st.tuples(cell, cell, cell, st.sampled_from(["a", "b"])), min_size=1, max_size=30))
def test_any_table_gives_channels_or_one_clear_line(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("table") / "table.csv"
    lines = ["time_s,displacement_m,force_N,run", *(",".join(str(v) for v in row) for row in rows)]
    path.write_text("\n".join(lines))
    found = outcome(path)
    if isinstance(found, tuple):
        assert len(found[0]) == len(rows)
        assert np.isfinite(found[0].velocity).all()
    else:
        assert "\n" not in found


@given(
    st.lists(st.floats(1e-3, 1.0), min_size=5, max_size=25),
    st.lists(st.floats(-1e3, 1e3), min_size=25, max_size=25),
)
def test_any_increasing_times_and_finite_forces_are_accepted(tmp_path_factory, steps, forces):
    path = tmp_path_factory.mktemp("good") / "good.csv"
    time_s = np.cumsum(steps)
    force = np.array(forces[: len(steps)])
    channel = only(
        import_file(
            write_csv(path, {"time_s": time_s, "displacement_m": force, "force_N": force}),
            ImportOptions(
                columns={"displacement": "displacement_m"}, units={"displacement": "1m", "force": "1N"}
            ),
        )
    )
    np.testing.assert_array_equal(channel.effort, force)
    assert np.isfinite(channel.acceleration).all()


def test_pairs_are_parsed():
    assert parse_pairs(["force_N = load", "run=log"], "--column") == {"force_N": "load", "run": "log"}
    assert parse_pairs(["force=a=b"], "--column") == {"force": "a=b"}
    assert parse_pairs(["a=b=mN"], "--unit") == {"a=b": "mN"}
    for wrong in (["force_N"], ["=load"], ["force_N="]):
        with pytest.raises(InputError, match=r"--column .*write it as NAME=VALUE"):
            parse_pairs(wrong, "--column")
    with pytest.raises(InputError, match="is given twice"):
        parse_pairs(["a=1", "a=2"], "--unit")


@pytest.mark.parametrize("name", ["big.csv", "big.csv.gz", "big.npz", "big.parquet"])
def test_oversized_data_are_refused(tmp_path, monkeypatch, contact, name):
    monkeypatch.setattr(file_columns, "MAX_BYTES", 500)
    file = tmp_path / name
    if name.endswith(".npz"):
        np.savez_compressed(file, **PRESS | {"force_N": 0 * F})
    elif name.endswith(".parquet"):
        pyarrow.parquet.write_table(pa.table(PRESS), file)
    else:
        content = contact().read_bytes()
        file.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    assert "split it" in refusal(file)


def test_compressed_file_with_large_content_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic_write, "_ALLOWED_BYTES", 100_000)
    file = tmp_path / "x.parquet"
    same = pa.DictionaryArray.from_arrays(np.zeros(2000, np.int32), pa.array(["x" * 1000]))
    pyarrow.parquet.write_table(pa.table({"a": same}), file, store_schema=False)
    assert file.stat().st_size < 20_000
    assert "x.parquet: holds more than the limit of 0 MiB" in refusal(file)


def test_fresh_runs_start_at_time_zero_and_keep_their_motion(contact, tmp_path):
    path = contact(time_s=T + 7.0, run=np.repeat([3, 5], 25))
    one_clock, fresh = (only(import_file(path, ImportOptions(fresh=way))) for way in (False, True))
    np.testing.assert_allclose(fresh.time_s, np.tile(T[:25], 2), atol=1e-12)
    np.testing.assert_allclose(one_clock.time_s, T + 7.0)
    np.testing.assert_allclose(fresh.velocity, one_clock.velocity, atol=1e-9)
    write_session(
        tmp_path / "s.mcap",
        import_streams(import_file(path, ImportOptions(fresh=True))),
        SessionMetadata(software_version="test", created_utc="", command_line=""),
    )
    (again,) = open_source(tmp_path / "s.mcap").channels
    np.testing.assert_allclose(again.time_s, fresh.time_s, atol=1e-9)


def forces(**changed):
    """The forces, some of them something else: `at_16="x"`."""
    force = F.astype(object)
    for place, value in changed.items():
        force[int(place[3:])] = value
    return force


TWO_SPECIMENS = ["P1"] * 30 + ["P2"] * 20
BACK = np.where(T < 0.295, T, T - 0.2)
SWING = {"displacement_m": None, "force_N": None, "position_rad": 0.001 * np.sin(9 * T), "torque_Nm": F}
RATE = 0.009 * np.cos(9 * T)
TEMPERATURES = {"temp (C)": 20 + T, "temp [C]": 25 + T}


@pytest.mark.parametrize(
    ("changed", "options", "words"),
    [
        ({"force_N": forces(at_16="oops")}, {}, "line 18, column 'force_N': 'oops' is not a finite number"),
        (
            {"force_N": forces(at_16="inf", at_17="inf", at_18="inf")},
            {},
            "'inf' is not a finite number (2 more",
        ),
        ({"force_N": forces(at_16="1,5")}, {}, "line 18 has 4 cells, but the header has 3"),
        (
            {"force_N": forces(at_40="inf"), "specimen": TWO_SPECIMENS},
            {"where": {"specimen": "P2"}},
            "line 42, column 'force_N'",
        ),
        ({"time_s": BACK}, {}, "line 32, column 'time_s': 0.1 s does not come after 0.29 s in line 31"),
        ({"time_s": BACK, "run": ["one"] + ["two"] * 49}, {}, "of run 'two'"),
        ({"time_s": np.zeros(50)}, {}, "has the same time in all rows; name the time column with --column"),
        ({"time_s": np.full(50, 0.01)}, {}, "and --unit time=0.01s if it is the interval of rows"),
        ({"force_N": None}, {}, "a contact needs time_s, displacement_m, force_N"),
        ({"force_N": None, "F [N]": forces(at_7="inf")}, {}, "line 9, column 'F [N]': 'inf' is not a finite"),
        ({"force_N": None, "F [N]": [""] * 50}, {}, "line 2, column 'F [N]': '' is not a finite"),
        ({"force_N": None, "F [N]": [1e300] * 50}, {}, "line 2, column 'F [N]': '1e+300' is too large"),
        ({}, {"columns": {"force_N": "load"}}, "has only time_s, displacement_m, force_N"),
        ({}, {"where": {"specimn": "P1"}}, "no column 'specimn'"),
        ({"specimen": ["P1"] * 50}, {"where": {"specimen": "P2"}}, "no such row. Available: P1"),
        (
            {"displacement_m": None, "force_N": None, "force": F, "depth": X},
            {},
            "state no units; give them, as in --unit force=N --unit displacement=m",
        ),
        ({}, {"units": {"displacement": "N"}}, "is not a unit of displacement"),
        ({}, {"units": {"force": "1e999N"}}, "unit '1e999N' cannot be converted"),
        ({}, {"units": {"displacement": "furlong"}}, "Valid: "),
        ({}, {"units": {"torque": "Nm"}}, "--unit torque=Nm: no quantity or column in use has this name"),
        (
            {"torque_Nm": F},
            {"units": {"torque": "mNm"}},
            "--unit torque=mNm: no channel uses 'torque_Nm' as torque.",
        ),
        (
            {"noise": F},
            {"columns": {"torque_Nm": "noise"}},
            "--column torque_Nm=noise: no channel uses 'noise'",
        ),
        (SWING, {"units": {"position_rad": "mm"}}, "'torque_Nm' in Nm, but a torque goes with an angle"),
        (SWING, {"units": {"torque_Nm": "V"}}, "add --unit torque=0.1Nm/V. Valid: Nm"),
        (
            {"displacement_m": None, "force_N": None, "Position[mm]": X, "MotorCurrent[A]": F},
            {},
            "linear motor of 20 N/A, add --column force='MotorCurrent[A]' --unit force=20N/A",
        ),
        (
            {"displacement_m": None, "force_N": None, "q1": X, "q2": -X, "I1": F, "I2": -F},
            {"columns": {"torque_Nm": "I1"}},
            "--column position=q1 --unit position=rad --column torque=I1",
        ),
        (
            {"force_N": None, "Load A [N]": forces(at_40="oops"), "Load B [N]": 2.0 * F},
            {},
            "columns 'Load A [N]' and 'Load B [N]' may hold force; choose with --column force=",
        ),
        ({}, {"columns": {"colour_N": "force_N"}}, "is not a quantity, or its unit is unknown"),
        ({"displacement_mm": X}, {}, "'displacement_m' and 'displacement_mm' both hold displacement"),
        ({"run": ["long"] * 47 + ["short"] * 3}, {}, "run 'short' has 3 rows, but at least 5"),
        ({"phase": ["hold", "squeeze"] + ["hold"] * 48}, {}, "no phase is called 'squeeze'. Valid"),
        (TEMPERATURES, {"context": tuple(TEMPERATURES)}, "rename one"),
        *(
            ({"run": np.zeros(50, int)}, {"context": (name,)}, f"--context {name}: this column is already")
            for name in ("force_N", "run")
        ),
    ],
)
def test_unusable_columns_are_refused_with_a_remedy(contact, changed, options, words):
    assert words in refusal(contact(**changed), **options)


def test_displacement_unit_may_be_given_by_either_name(contact):
    depth = 3.0 * np.abs(np.sin(7.0 * T)) - 0.5  # mm
    force = 2.0 * depth.clip(0.0)
    file = contact(displacement_m=None, force_N=None, pos=depth, force1=force, force2=force[::-1])
    stated = re.search(r"choose with (.+)", refusal(file))[1].split()
    assert stated == ["--column", "force=force1", "--unit", "position=mm", "--unit", "force=N"]
    for name in ("position", "pos"):
        options = ImportOptions(columns={"force": "force1"}, units={name: "mm", "force": "N"})
        channel = only(import_file(file, options))
        assert channel.name == "contact"
        np.testing.assert_allclose(channel.position, 0.001 * depth)


@pytest.mark.parametrize(
    ("changed", "omitted", "reason"),
    [
        *(
            ({"force_N": forces(at_16=mark, at_30=mark)}, [16, 30], "no value in 'force_N'")
            for mark in ("", "nan", " n/a ")
        ),
        ({"time_s": np.where(np.arange(50) == 20, T[19], T)}, [20], "they repeat the previous time"),
    ],
)
def test_rows_without_a_value_or_a_new_time_are_left_out_and_counted(contact, changed, omitted, reason):
    imported = import_file(contact(**changed))
    np.testing.assert_array_equal(imported.channels[0].effort, np.delete(F, omitted))
    note = f"{len(omitted)} of 50 rows left out: {reason}; the first is in line {omitted[0] + 2}"
    assert note in imported.notes


def swung(sign, friction=0.3, early=0, inertia=0.02):
    """A joint that swings in sweeps, with inertia, a spring and friction; its effort may be read early."""
    t = np.arange(4000) * 0.005
    phase = 2.0 * t + 0.2 * t**2
    q, v = 0.4 * np.sin(phase), 0.4 * np.cos(phase) * (2.0 + 0.4 * t)
    a = -0.4 * np.sin(phase) * (2.0 + 0.4 * t) ** 2 + 0.16 * np.cos(phase)
    torque = inertia * a + 0.5 * q + friction * np.sign(v)
    torque += np.random.default_rng(0).normal(0.0, 0.02, len(t))
    return {"time_s": t, "position_rad": q, "torque_Nm": sign * np.roll(torque, -early)}


def read_swing(tmp_path, options=None, **swing):
    return import_file(write_csv(tmp_path / "swing.csv", swung(**swing)), options or ImportOptions())


def test_torque_that_opposes_the_velocity_is_a_reaction(tmp_path):
    imported, reaction = (read_swing(tmp_path, sign=sign) for sign in (1.0, -1.0))
    np.testing.assert_array_equal(only(reaction).effort, only(imported).effort)
    assert not any("opposes" in note for note in imported.notes)
    assert "'torque_Nm' opposes the velocity" in reaction.notes[-1]
    kept = read_swing(tmp_path, ImportOptions(units={"torque": "1Nm"}), sign=-1.0)
    np.testing.assert_array_equal(only(kept).effort, -only(imported).effort)


@pytest.mark.parametrize(("early", "inertia"), [(8, 0.02), (-16, 0.002)])
def test_time_shifted_torque_is_no_reaction(tmp_path, early, inertia):
    """An inertia's effort ahead of its motion, and a spring's behind it, look like a negative damping."""
    imported = read_swing(tmp_path, sign=1.0, friction=0.0, early=early, inertia=inertia)
    assert not any("opposes" in note for note in imported.notes)


@pytest.mark.parametrize(("sign", "late"), [(1.0, 20), (1.0, 30), (-1.0, 0)])
def test_late_weight_of_a_joint_in_ramps_is_no_reaction(tmp_path, sign, late):
    """The delayed weight is like a negative damping, and the inertia acts when the delayed one does not."""
    t = np.arange(4000) * 0.005
    q = gaussian_filter1d(0.4 * np.arcsin(np.sin(0.8 * t + 0.3 * np.sin(0.5 * t))), 5.0)
    v = np.gradient(q, t)
    torque = 0.05 * np.gradient(v, t) + 3.0 * np.sin(q) + 0.05 * v
    reading = sign * np.roll(torque, late) + np.random.default_rng(0).normal(0.0, 0.002, len(t))
    table = {"time_s": t, "position_rad": q, "torque_Nm": reading}
    imported = import_file(write_csv(tmp_path / "ramps.csv", table))
    assert any("opposes" in note for note in imported.notes) is (sign < 0.0)


@pytest.mark.parametrize(("sign", "late_s"), [(1.0, 0.2), (-1.0, 0.0)])
def test_late_spring_of_a_linear_axis_is_no_reaction(tmp_path, sign, late_s):
    t = np.arange(4000) * 0.005
    x, late = (0.01 * np.minimum(s, 1.0 - np.cos(2.0 * np.maximum(s - 1.0, 0.0))) for s in (t, t - late_s))
    force = sign * (20.0 + 500.0 * late + 50.0 * np.gradient(late, t))
    force += np.random.default_rng(0).normal(0.0, 0.5, len(t))
    table = {"time_s": t, "position_m": x, "force_N": force}
    imported = import_file(write_csv(tmp_path / "axis.csv", table))
    assert any("opposes" in note for note in imported.notes) is (sign < 0.0)


@pytest.mark.parametrize(
    ("torque", "is_reaction"),
    [(lambda q, v: 2.0 + np.sin(3.0 * q), False), (lambda q, v: -v, True)],
    ids=["drive that slows down under load", "reaction to viscous friction"],
)
def test_reaction_in_one_turn_does_negative_work(tmp_path, torque, is_reaction):
    q = np.linspace(0.0, 6.0, 2000)
    v = 1.0 - 0.5 * np.sin(3.0 * q)
    table = {"time_s": np.cumsum(np.gradient(q) / v), "position_rad": q, "torque_Nm": torque(q, v)}
    imported = import_file(write_csv(tmp_path / "turn.csv", table))
    assert any("opposes" in note for note in imported.notes) is is_reaction


@pytest.mark.parametrize(
    ("names", "stiffness", "damping"),
    [(("position_rad", "torque_Nm"), 3.0, 0.5), (("position_m", "force_N"), 0.05, 0.5)],
    ids=["inverted weight", "weak spring of a linear axis"],
)
def test_reaction_may_grow_with_the_position(tmp_path, names, stiffness, damping):
    t = np.arange(4000) * 0.005
    q, v = 0.3 * np.sin(2.0 * t) + 0.1 * np.sin(5.0 * t), 0.6 * np.cos(2.0 * t) + 0.5 * np.cos(5.0 * t)
    table = {"time_s": t, names[0]: q, names[1]: stiffness * np.sin(q) - damping * v}
    imported = import_file(write_csv(tmp_path / "reaction.csv", table))
    assert any("opposes" in note for note in imported.notes)


def test_joint_with_a_clear_sign_decides_for_the_others(tmp_path):
    first, second = swung(sign=-1.0), swung(sign=-1.0, friction=0.0)
    columns = {"time_s": first["time_s"]}
    for number, joint in ((1, first), (2, second)):
        columns |= {f"joint_{number}_{name}": joint[name] for name in ("position_rad", "torque_Nm")}
    file = write_csv(tmp_path / "arm.csv", columns)
    imported = import_file(file)
    for channel, joint in zip(imported.channels, (first, second), strict=True):
        np.testing.assert_allclose(channel.effort, -joint["torque_Nm"])
    assert "so their signs are reversed; to prevent this, add --unit torque=1Nm" in imported.notes[-1]
    kept = import_file(file, ImportOptions(units={"torque": "1Nm"}))
    for channel, joint in zip(kept.channels, (first, second), strict=True):
        np.testing.assert_allclose(channel.effort, joint["torque_Nm"])


def test_file_with_a_clear_sign_decides_for_the_others(tmp_path):
    swings = [swung(sign=-1.0), swung(sign=-1.0, friction=0.0)]
    files = [write_csv(tmp_path / f"{number}.csv", swing) for number, swing in enumerate(swings)]
    imported = import_files(files, ImportOptions())
    recorded = np.concatenate([swing["torque_Nm"] for swing in swings])
    np.testing.assert_allclose(only(imported).effort, -recorded)
    assert imported.run_labels == {0: "0.csv", 1: "1.csv"}
    assert "2 files, read as one table, because alone their signs would differ" in imported.read
    write_csv(files[1], {name.replace("torque_Nm", "torque [Nm]"): swings[1][name] for name in swings[1]})
    assert len(only(import_files(files, ImportOptions()))) == len(recorded)  # not joined


def test_exactly_repeated_simulated_run_is_a_run(contact):
    imported = import_file(contact(**{name: np.tile(values, 3) for name, values in PRESS.items()}))
    assert len(only(imported).runs) == 3
    np.testing.assert_array_equal(only(imported).effort, np.tile(F, 3))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"velocity_m_s": 1e3 * RATE}, "'velocity_m_s' is 999 times the rate of change of 'displacement_m'"),
        (SWING | {"velocity_rad_s": -0.1 * RATE}, "column 'velocity_rad_s' is -0.0999 times"),
        (SWING | {"velocity_rad_s": -RATE}, "wrong sign"),
        (SWING | {"velocity_m_s": X}, "its unit does not match that of 'position_rad'"),
        ({"velocity_m_s": RATE, "acceleration_m_s2": -8.1 * np.sin(9 * T)}, "acceleration_m_s2' is 99.9"),
    ],
)
def test_contradictory_derivative_is_replaced_and_reported(contact, changed, words):
    imported = import_file(contact(**changed))
    assert words in " ".join(imported.notes)
    derived = only(
        import_file(contact(**{n: v for n, v in changed.items() if n[:4] not in {"velo", "acce"}}))
    )
    kept = RATE if "acceleration" in words else derived.velocity
    np.testing.assert_array_equal(only(imported).velocity, kept)


def test_resting_joint_does_not_refuse_the_recording(contact):
    """Its encoder toggles between two steps, and its velocity is exactly zero."""
    toggles = 1e-5 * (np.arange(50) % 3 == 0)
    resting = {"position_2_rad": 0.3 + toggles, "velocity_2_rad_s": np.zeros(50), "torque_2_Nm": np.zeros(50)}
    moving = {"position_1_rad": X, "velocity_1_rad_s": RATE, "torque_1_Nm": F}
    joints = import_file(contact(displacement_m=None, force_N=None, **moving, **resting)).channels
    np.testing.assert_array_equal(joints[0].velocity, RATE)
    np.testing.assert_array_equal(joints[1].velocity, 0.0)


TEXT = "time_s,displacement_m,force_N\n" + "".join(f"{i / 100},{0.001 * i},{i}\n" for i in range(9))
HEADER = b"time_s,displacement_m,force_N\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.csv", None, "no such file"),
        ("empty.csv", b"", "no rows of data; the file is empty"),
        ("trailing.csv", "0:01.0,-1.0,0.5 0:01.0,-1.0,0.5\n" * 60 + " ", "no channel can be made of"),
        ("one.csv", b"force\n1\n2\n3\n", "holds only one column, 'force'; a measurement needs at least"),
        ("header.csv", HEADER, "no rows of data"),
        ("page.csv", "<html>404</html>", "no rows of data"),
        ("numbers.csv", b"0,1,2\n1,2,3\n", "the file has no column names; its first row is 0, 1, 2"),
        ("short.csv", TEXT.replace("\n0.03,0.003,3", "\n0.03,0.003"), "header has 3: '0.03,0.003'"),
        ("long.csv", TEXT.replace("\n0.03,", "\n0.03,7,"), "line 5 has 4 cells, but the header has 3"),
        ("line.csv", TEXT.replace("\n0.03,", "\n1_0,"), "line 5, column 'time_s': '1_0' is not a finite"),
        ("huge.csv", TEXT.replace(",3\n", ",1e300\n"), "line 5, column 'force_N': '1e300' is too large"),
        ("half.csv", TEXT.encode("utf-16")[:-1], "is not a text file; save it as CSV in UTF-8"),
        ("binary.csv", bytes(range(256)), "is not a text file"),
        ("words.csv", "a letter\n\nDear Sir,\n1,2\n", "no line of column names"),
        ("first.csv", "time [s],force [N]\n0,over\n1,2\n", "'time [s],force [N]', then '0,over'; write"),
        ("endless.csv", HEADER + b"1" * 3_000_000 + b"\n", "a line is longer than 1 MiB"),
        ("wide.csv", b"," * 2_000_000 + b"\n1,2\n", "its first line is longer than 1 MiB"),
        ("torn.csv.gz", gzip.compress(HEADER + b"1,2,3\n" * 9, mtime=0)[:25], "cannot be read"),
        ("not.csv.gz", HEADER + b"0,1,2\n", "cannot be read"),
        ("broken.parquet", b"PAR1 nonsense", "cannot be read"),
        ("broken.npz", b"PK nonsense", "cannot be read"),
        ("data.xlsx", b"PK", "cannot be read"),
        ("text.xlsx", TEXT, "not an Excel workbook; if it is a text file, rename it to .csv"),
        ("empty.xls", b"", "not an Excel workbook"),
        ("data.pdf", b"%PDF", "unknown kind of file"),
    ],
)
def test_broken_files_get_one_line(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    text = refusal(path)
    assert message in text
    assert str(path) in text


def test_arrays_that_make_no_table_are_named(tmp_path):
    holes, objects, uneven = (tmp_path / name for name in ("holes.parquet", "objects.npz", "uneven.npz"))
    force = [*F[:10].tolist(), None, *F[11:].tolist()]
    pa.parquet.write_table(pa.table({"time_s": T, "displacement_m": X, "force_N": force}), holes)
    assert "no value in 'force_N'; the first is in row 11" in import_file(holes).notes[0]
    np.savez(objects, time_s=np.array([{"a": 1}], dtype=object))  # and it is not unpickled
    assert "column 'time_s' holds Python objects" in refusal(objects)
    np.savez(uneven, time_s=T, displacement_m=X[:-1], force_N=F)
    assert "different lengths" in refusal(uneven)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_ambiguous_arrays_are_refused(tmp_path):
    path, other = tmp_path / "data.npz", tmp_path / "other.npy"
    np.savez(path, **PRESS)
    np.save(other, 2 * F)
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(other, "force_N.npy")
    assert "the array 'force_N' appears twice" in refusal(path)


@pytest.mark.parametrize(
    ("columns", "name", "kind"),
    [
        ({"Time [nanoseconds]": 1e9 * T, "displacement_m": X, "force_mN": 1e3 * F}, "contact", "CONTACT"),
        ({"time_s": T, "depth_um": 1e6 * X, "force_n": F}, "contact", "CONTACT"),
        ({"time_ms": 1e3 * T, "position_deg": np.degrees(X), "torque_mNm": 1e3 * F}, "joint_1", "REVOLUTE"),
        ({"time_s": T, "angle_deg": np.degrees(X), "torque_Nm": F}, "joint_1", "REVOLUTE"),
        ({"time_s": T, "position_m": X, "force_N": F}, "joint_1", "PRISMATIC"),
    ],
)
def test_names_give_quantities_and_si_units(tmp_path, columns, name, kind):
    channel = only(import_file(write_csv(tmp_path / "units.csv", columns)))
    assert (channel.name, channel.kind) == (name, ChannelKind[kind])
    np.testing.assert_allclose(channel.time_s, T, atol=1e-12)
    np.testing.assert_allclose(channel.position, X)
    np.testing.assert_allclose(channel.effort, F)


def test_column_option_selects_one_of_two(contact):
    chosen = ImportOptions(columns={"displacement_m": "displacement_mm"})
    np.testing.assert_allclose(only(import_file(contact(displacement_mm=2e3 * X), chosen)).position, 2 * X)
    only(import_file(contact(time_s=BACK, run=[0] * 30 + [1] * 20)))


def test_slow_press_without_time_uses_row_numbers_and_notes_it(contact):
    imported = import_file(contact(time_s=None))
    channel = only(imported)
    assert (np.diff(channel.time_s) == 1.0).all()
    assert channel.effort == pytest.approx(F)
    assert any(
        "no time column was found, so rows are assumed to be 1 s apart" in note for note in imported.notes
    )


def test_unit_of_a_missing_time_is_the_interval_of_rows(contact, tmp_path):
    imported = import_file(contact(time_s=None), ImportOptions(units={"time": "20 ms"}))
    assert not any("no time column" in note for note in imported.notes)
    assert np.diff(only(imported).time_s) == pytest.approx(0.02)
    t = np.arange(300) * 0.02
    np.savez(tmp_path / "arm.npz", qpos=np.sin(3.0 * t), effort=np.cos(3.0 * t))
    units = {"position": "rad", "torque": "Nm", "time": "20ms"}
    joint = only(import_file(tmp_path / "arm.npz", ImportOptions(units=units)))
    assert joint.velocity[50:-50] == pytest.approx(3.0 * np.cos(3.0 * t)[50:-50], abs=0.05)
    with pytest.raises(InputError, match="is not a unit of time"):
        import_file(contact(time_s=None), ImportOptions(units={"time": "N"}))


def test_recorded_velocity_tells_the_interval_of_rows_without_a_time(tmp_path):
    t = np.arange(600) * 0.01
    columns = {"pos1": np.sin(3.0 * t), "vel1": 3.0 * np.cos(3.0 * t), "torque1": np.cos(3.0 * t)}
    units = ImportOptions(units={"position": "rad", "torque": "Nm"})

    def advice():
        imported = import_file(write_csv(tmp_path / "arm.csv", columns), units)
        return next(note for note in imported.notes if note.startswith("no time column"))

    told = "rows are 10 ms apart according to 'vel1', if it is in rad/s; add --unit time=10ms"
    assert advice().endswith(told)
    columns["torque1"][::3] = np.nan  # left out, but the others stay 10 ms apart
    assert advice().endswith(told)
    columns["torque1"] = columns["pos1"]
    columns["vel1"][400:] *= 2.0  # contradicts the rest
    assert advice().endswith("give their interval, as in --unit time=10ms")
    columns["vel1 [deg/s]"] = np.degrees(3.0 * np.cos(3.0 * t)) / 2.0
    del columns["vel1"]
    assert advice().endswith("rows are 20 ms apart according to 'vel1 [deg/s]'; add --unit time=20ms")
    columns = {name: values[:8] for name, values in columns.items()}  # too few
    assert advice().endswith("give their interval, as in --unit time=10ms")


def test_velocity_named_by_the_user_tells_the_interval_of_rows(tmp_path):
    t = np.arange(600) * 0.01
    columns = {"a": np.sin(3.0 * t), "b": 3.0 * np.cos(3.0 * t), "c": np.cos(3.0 * t)}
    names = {"position": "a", "velocity": "b", "torque": "c"}
    units = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
    notes = import_file(write_csv(tmp_path / "arm.csv", columns), ImportOptions(names, units)).notes
    assert notes[0].endswith("rows are 10 ms apart according to 'b'; add --unit time=10ms")
    assert notes[1].endswith("if its unit is right, rows are 10 ms apart; then add --unit time=10ms")


@pytest.mark.parametrize("name", ["tick", "ticks", "stamp", "sample counter"])
def test_counter_is_proposed_as_the_time_and_asked_for_its_unit(contact, name):
    path = contact(time_s=None, **{name: 20.0 * np.arange(len(T)), "note": T})
    (advice,) = (note for note in import_file(path).notes if note.startswith("no time column"))
    assert f"if '{name}', which rises by 20 per row, counts the time, add --column time=" in advice
    assert "--unit time=UNIT" in advice
    chosen = ImportOptions(columns={"time": name}, units={"time": "0.0005s"})
    np.testing.assert_allclose(only(import_file(path, chosen)).time_s, 0.01 * np.arange(len(T)))
    if name != "stamp":
        with pytest.raises(InputError, match="is not a known unit of time; give it"):
            import_file(path, ImportOptions(columns={"time": name}))


def test_column_that_rises_unevenly_is_not_proposed_as_the_time(contact):
    path = contact(time_s=None, ticks=np.arange(len(T)) ** 3)
    assert any("add --column time=COLUMN" in note for note in import_file(path).notes)


def test_radial_travel_that_looks_like_an_angle_may_be_a_length(contact):
    path = contact(displacement_m=None, force_N=None, EXT_RAD=1e3 * X, FORCE=F)
    with pytest.raises(InputError, match="if 'EXT_RAD' is a length, add --column displacement=EXT_RAD"):
        import_file(path)
    options = ImportOptions(
        {"displacement": "EXT_RAD", "force": "FORCE"}, {"displacement": "mm", "force": "N"}
    )
    np.testing.assert_allclose(only(import_file(path, options)).position, X)


@pytest.mark.parametrize("motion", ["velocity", "position"])
def test_motion_along_a_line_with_a_torque_is_refused_with_both_remedies(tmp_path, motion):
    unit = {"velocity": "m/s", "position": "m"}[motion]
    path = write_csv(tmp_path / "axis.csv", {"time_s": T, f"{motion} [{unit}]": X, "torque [Nm]": F})
    with pytest.raises(InputError) as caught:
        import_file(path)
    text = str(caught.value)
    assert f"is in {unit} and 'torque [Nm]' in Nm, but a torque goes with an angle" in text
    turning = {"velocity": "rad/s", "position": "rad"}[motion]
    assert f"if the axis turns, add --unit {motion}={turning}; if it moves along a line" in text
    assert "--column force='torque [Nm]' --unit force=10N" in text
    channel = only(import_file(path, ImportOptions(units={motion: turning})))
    assert channel.kind is ChannelKind.REVOLUTE
    chosen = ImportOptions(columns={"force": "torque [Nm]"}, units={"force": "10N"})
    channel = only(import_file(path, chosen))
    np.testing.assert_allclose(np.abs(channel.effort), np.abs(10.0 * F))


def test_displacement_words_are_ignored_where_another_column_holds_it(contact):
    stroke = ["down"] * 25 + ["up"] * 25
    columns = {"displacement_m": None, "force_N": None, "time_s": None}
    path = contact(**columns, **{"travel (mm)": 1e3 * X, "force (gf)": F, "stroke": stroke})
    assert only(import_file(path)).position == pytest.approx(X)


def test_joint_without_an_effort_column_is_refused_with_a_hint(contact):
    motor = {"position (rad)": X, "velocity (rad/s)": np.gradient(X, T), "voltage (V)": F}
    path = contact(displacement_m=None, force_N=None, **motor)
    assert "--column torque='voltage (V)' --unit torque=1Nm" in refusal(path)
    options = {"columns": {"torque": "voltage (V)"}, "units": {"torque": "1Nm"}}
    assert only(import_file(path, ImportOptions(**options))).effort == pytest.approx(F)


def test_stated_number_of_presses_does_not_fix_clock_restarts(contact):
    several = np.tile(np.arange(50), 3)
    path = contact(**{name: values[several] for name, values in PRESS.items()})
    with pytest.raises(InputError, match="2: the clock restarts 2 times, so there are at least 3 runs"):
        import_file(path, ImportOptions(runs=2))
    imported = import_file(path, ImportOptions(runs=1))
    assert len(imported.run_labels) == 3
    assert "if that is wrong, name the column that numbers the runs" in imported.notes[-1]
    assert "--runs" not in imported.notes[-1]


SWING_S = np.tile(np.arange(400) * 0.01, 2)
SWING = {"time_s": SWING_S, "run": np.repeat([0.0, 1.0], 400), "torque_Nm": np.sin(SWING_S) + 2.0}
ANGLE = 4.0 * SWING_S + 3.0 * np.sin(3.0 * SWING_S) + 2.0  # rad


@pytest.mark.parametrize(
    ("name", "low", "turn", "unit"),
    [
        ("angle_deg", 0.0, 360.0, {}),
        ("angle_deg", -180.0, 360.0, {}),
        ("position_rad", 0.0, 2.0 * np.pi, {}),
        ("position", 0.0, 1.0, {"position": "rev"}),
        ("encoder_counts", 0.0, 4096.0, {"position": "0.00153rad"}),
    ],
)
def test_angle_measured_within_one_turn_is_continuous(tmp_path, name, low, turn, unit):
    factor = 0.00153 if "0.00153rad" in unit.values() else 2.0 * np.pi / turn
    wrapped = (ANGLE / (2.0 * np.pi) * turn - low) % turn + low
    imported = import_file(
        write_csv(tmp_path / "joint.csv", SWING | {name: np.round(wrapped, 4)}), ImportOptions(units=unit)
    )
    channel = only(imported)
    moved = channel.position.reshape(2, -1) - channel.position[[0, 400]][:, None]
    np.testing.assert_allclose(moved, (ANGLE - 2.0).reshape(2, -1) * factor * turn / (2.0 * np.pi), atol=2e-3)
    assert np.max(np.abs(channel.velocity)) < 14.0
    assert f"jumps by {turn:.4g} " in " ".join(imported.notes)
    assert "is read as continuous" in " ".join(channel.import_warnings)


@pytest.mark.parametrize(("unit", "factor"), [("-1rad", -1.0), ("0.02rad", 0.02), ("-1deg", -np.pi / 180.0)])
def test_turns_of_a_reversed_or_geared_angle_are_exact(tmp_path, unit, factor):
    path = write_csv(
        tmp_path / "joint.csv", SWING | {"angle": ANGLE % (360.0 if "deg" in unit else 2 * np.pi)}
    )
    channel = only(import_file(path, ImportOptions(units={"position": unit})))
    np.testing.assert_allclose(np.diff(channel.position[:400]), factor * np.diff(ANGLE[:400]), atol=1e-6)


def test_jumps_that_are_no_whole_turns_are_kept(tmp_path):
    degrees = np.minimum(20.0 * SWING_S, 60.0) + 290.0 + 0.0 * ANGLE
    lost = np.where(np.arange(800) % 300 == 50, 0.0, degrees)
    fast = (ANGLE * 180.0 / np.pi * 20.0) % 360.0
    names = "linear_m", "angle_deg", "angle_deg"
    for name, column in zip(names, (ANGLE % (2.0 * np.pi), lost, fast), strict=True):
        effort = {"force_N": SWING["torque_Nm"]} if name == "linear_m" else {}
        table = {key: values for key, values in SWING.items() if not (effort and key == "torque_Nm")} | effort
        path = write_csv(tmp_path / "joint.csv", table | {name.replace("linear", "position"): column})
        imported = import_file(path)
        factor = 1.0 if effort else np.pi / 180.0
        np.testing.assert_allclose(only(imported).position, factor * column, rtol=1e-6)
        assert ("is not smooth enough" in " ".join(imported.notes)) is (name != "linear_m")
    path = write_csv(tmp_path / "joint.csv", SWING | {"angle_deg": np.degrees(ANGLE) % 360.0})
    assert np.ptp(only(import_file(path, ImportOptions(units={"position": "1deg"}))).position) < 6.3


def test_angle_in_the_other_unit_is_told_by_the_size_of_its_jumps(tmp_path):
    for name, wrapped, other in (
        ("position_rad", np.degrees(ANGLE) % 360.0, "deg"),
        ("position_deg", ANGLE % 6.283185307, "rad"),
    ):
        imported = import_file(write_csv(tmp_path / "joint.csv", SWING | {name: wrapped}))
        assert f"add --unit position={other}" in " ".join(only(imported).import_warnings)


# Over several turns, across one border, and only the goal across it.
@pytest.mark.parametrize("angle", [ANGLE, np.sin(SWING_S), 0.02 * np.sin(SWING_S) - 0.04])
def test_goal_and_angle_of_a_servo_turn_together(tmp_path, angle):
    motion = {"position_rad": angle % (2.0 * np.pi), "goal_rad": (angle + 0.05) % (2.0 * np.pi)}
    path = write_csv(tmp_path / "s.csv", {"time_s": SWING_S, "run": SWING["run"]} | motion)
    np.testing.assert_allclose(only(import_file(path)).effort, 0.05, atol=1e-6)


SPEED = np.gradient(ANGLE, 0.01)  # rad/s


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"Angle [rad]": np.degrees(ANGLE), "Velocity [rad/s]": SPEED}, "--unit position=deg"),
        ({"motor_pos_rad": 50.0 * ANGLE, "link_vel_rad_s": SPEED}, "is 0.02 times the rate"),
        ({"angle_rad": ANGLE, "motor speed (rpm)": 50.0 * SPEED * 30.0 / np.pi}, "is 50 times the rate"),
        ({"Motor pos [turns]": ANGLE, "Joint torque [Nm]": SWING_S}, "add --unit position=0.02rev"),
        ({"Joint angle [deg]": ANGLE, "Motor torque [Nm]": SWING_S}, "add --unit torque=50Nm"),
    ],
)
def test_columns_of_two_units_or_of_two_sides_of_a_gear_are_reported(tmp_path, columns, words):
    torque = {} if any("torque" in name for name in columns) else {"tau_Nm": SWING["torque_Nm"]}
    table = {"time_s": SWING_S, "run": SWING["run"], **torque, **columns}
    assert words in " ".join(only(import_file(write_csv(tmp_path / "joint.csv", table))).import_warnings)


@pytest.mark.parametrize(
    ("bits", "name", "rate_hz"),
    [(32, "micros", 1e6), (31, "time_ms", 1e3), (24, "time_us", 1e6), (16, "time_ms", 1e3)],
)
def test_counter_that_overflows_is_continued(tmp_path, bits, name, rate_hz):
    count = (np.arange(400) * int(0.01 * rate_hz) + 2**bits - int(2 * rate_hz)) % 2**bits
    table = {name: count, "angle_deg": ANGLE[:400], "torque_Nm": SWING["torque_Nm"][:400]}
    imported = import_file(write_csv(tmp_path / "joint.csv", table))
    np.testing.assert_allclose(np.diff(only(imported).time_s), 0.01, atol=1e-5)
    assert f"like a {bits}-bit counter" in " ".join(imported.notes)


def test_clock_that_restarts_after_65536_rows_of_1_ms_starts_a_run(tmp_path):
    rows = 2**16 + 200
    angle = np.sin(1e-3 * np.arange(rows))
    table = {"time_ms": np.arange(rows) % 2**16, "angle_rad": angle, "torque_Nm": 2.0 * angle}
    assert len(only(import_file(write_csv(tmp_path / "joint.csv", table))).runs) == 2


@pytest.mark.parametrize(("before", "after"), [("+02:00", "+01:00"), ("-0430", "-05:30"), ("Z", "-01:00")])
def test_change_of_the_offset_from_utc_moves_no_time(tmp_path, before, after):
    """As when summer time ends: the written times go back by an hour."""
    clock = np.datetime64("2026-10-25T02:59:58") + (SWING_S * 1e6).astype("timedelta64[us]")
    turn = len(clock) // 2
    written = [f"{t}{before}" for t in clock[:turn]] + [
        f"{t}{after}" for t in clock[turn:] - np.timedelta64(1, "h")
    ]
    table = {"time": written, "angle_deg": ANGLE, "torque_Nm": SWING["torque_Nm"]}
    channel = only(import_file(write_csv(tmp_path / "joint.csv", table)))
    np.testing.assert_allclose(np.diff(channel.time_s), np.diff(SWING_S), atol=2e-6)


@pytest.mark.parametrize("unit", ["s", "us"])
def test_clock_that_restarts_after_the_range_of_another_counter_starts_a_run(tmp_path, unit):
    clock_s = np.tile(np.arange(430) * 0.01, 2)  # 2^32 ns are 4.29 s
    table = {f"time_{unit}": clock_s / {"s": 1.0, "us": 1e-6}[unit], "angle_rad": np.sin(clock_s)}
    path = write_csv(tmp_path / "joint.csv", table | {"torque_Nm": np.cos(clock_s)})
    assert len(import_file(path).run_labels) == 2


def test_constant_lever_arm_is_no_displacement(tmp_path):
    table = {"Time [s]": SWING_S[:400], "Angle [deg]": ANGLE[:400], "Force [N]": np.sin(SWING_S[:400])}
    path = write_csv(tmp_path / "lever.csv", table | {"Arm [m]": np.full(400, 0.25)})
    assert "--unit torque=0.1Nm" in refusal(path)
