import gzip

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from control.loop.phases import Phase
from estimation.channel import ChannelKind
from estimation.data import table, text_table
from estimation.data.import_file import import_file
from estimation.data.import_options import ImportOptions, parse_pairs
from estimation.data.session_streams import import_streams
from estimation.study.source import open_source
from robot_io.errors import InputError
from robot_io.session import SessionMetadata, write_session

T = np.arange(50) * 0.01
X = 0.002 + 0.001 * np.sin(9 * T)
F = 500 * X


def write_csv(path, columns, delimiter=","):
    names = list(columns)
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [delimiter.join(names), *(delimiter.join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def contact(tmp_path):
    """Writes a contact file with changed or added columns; None removes one."""

    def write(name="data.csv", **changed):
        columns = {"time_s": T, "displacement_m": X, "force_N": F} | changed
        return write_csv(tmp_path / name, {n: v for n, v in columns.items() if v is not None})

    return write


def only(imported):
    (channel,) = imported.channels
    return channel


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        import_file(path, ImportOptions(**options))
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_contact(contact):
    channel = only(import_file(contact()))
    assert (channel.name, channel.kind) == ("contact", ChannelKind.CONTACT)
    np.testing.assert_allclose(channel.position, X)
    np.testing.assert_allclose(channel.effort, F)
    np.testing.assert_allclose(channel.velocity, 0.009 * np.cos(9 * T), atol=2e-5)
    np.testing.assert_allclose(channel.acceleration[5:-5], -0.081 * np.sin(9 * T)[5:-5], atol=2e-3)
    np.testing.assert_array_equal(channel.phase, -1)
    assert channel.surface is None


def test_joints(tmp_path):
    columns = {"time_s": T, "position_1_rad": X, "torque_1_Nm": F, "position_2_rad": -X, "torque_2_Nm": 2 * F}
    first, second = import_file(write_csv(tmp_path / "arm.csv", columns)).channels
    assert (first.name, second.name) == ("joint_1", "joint_2")
    assert second.kind is ChannelKind.REVOLUTE
    np.testing.assert_allclose(second.effort, 2 * F)
    np.testing.assert_allclose(first.context["joint_position"], np.column_stack([X, -X]))


def test_a_prismatic_joint(tmp_path):
    channel = only(
        import_file(write_csv(tmp_path / "axis.csv", {"time_s": T, "position_m": X, "force_N": F}))
    )
    assert (channel.name, channel.kind) == ("joint_1", ChannelKind.PRISMATIC)


def test_all_formats_hold_the_same(tmp_path, contact):
    csv = contact()
    packed = tmp_path / "data.csv.gz"
    packed.write_bytes(gzip.compress(csv.read_bytes()))
    parquet, npz = tmp_path / "data.parquet", tmp_path / "data.npz"
    pa.parquet.write_table(pa.table({"time_s": T, "displacement_m": X, "force_N": F}), parquet)
    np.savez(npz, time_s=T, displacement_m=X, force_N=F)
    semicolons = write_csv(tmp_path / "e.csv", {"time_s": T, "displacement_m": X, "force_N": F}, ";")
    tabs = write_csv(tmp_path / "e.tsv", {"time_s": T, "displacement_m": X, "force_N": F}, "\t")
    expected = only(import_file(csv))
    for path in (packed, parquet, npz, semicolons, tabs):
        channel = only(import_file(path))
        for what in ("time_s", "position", "velocity", "acceleration", "effort", "run"):
            np.testing.assert_array_equal(getattr(channel, what), getattr(expected, what))
    assert open_source(csv).channels[0].name == "contact"


def test_a_byte_order_mark_and_quotes_do_not_matter(tmp_path):
    text = '"time_s","displacement_m","force_N"\r\n' + "".join(
        f'{t},"{x}", {x}\r\n' for t, x in zip(T, X, strict=True)
    )
    path = tmp_path / "windows.csv"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    np.testing.assert_allclose(only(import_file(path)).effort, X)


@pytest.mark.parametrize(
    ("columns", "scale"),
    [
        ({"time_ms": 1e3 * T, "displacement_mm": 1e3 * X, "force_mN": 1e3 * F}, 1.0),
        ({"time_s": T, "displacement_um": 1e6 * X, "force_kN": 1e-3 * F}, 1.0),
    ],
)
def test_units_in_names_become_si(tmp_path, columns, scale):
    channel = only(import_file(write_csv(tmp_path / "units.csv", columns)))
    np.testing.assert_allclose(channel.time_s, T, atol=1e-12)
    np.testing.assert_allclose(channel.position, scale * X)
    np.testing.assert_allclose(channel.effort, F)


def test_degrees_become_radians(tmp_path):
    columns = {"time_s": T, "position_deg": np.degrees(X), "torque_mNm": 1e3 * F}
    channel = only(import_file(write_csv(tmp_path / "deg.csv", columns)))
    np.testing.assert_allclose(channel.position, X)
    np.testing.assert_allclose(channel.effort, F)


def test_columns_of_other_names_and_units(tmp_path):
    columns = {"t": 1e3 * T, "indent_mm": 1e3 * X, "load": 1e3 * F}
    path = write_csv(tmp_path / "own.csv", columns)
    options = ImportOptions(
        columns={"time": "t", "displacement_m": "indent_mm", "force_N": "load"},
        units={"time": "ms", "load": "mN"},
    )
    channel = only(import_file(path, options))
    np.testing.assert_allclose(channel.time_s, T, atol=1e-12)
    np.testing.assert_allclose(channel.position, X)  # the column's own name says mm
    np.testing.assert_allclose(channel.effort, F)


def test_a_unit_of_something_else_is_taken_as_it_stands_and_said(tmp_path):
    path = write_csv(tmp_path / "cell.csv", {"time_s": T, "weight_N": F, "force_N": F})
    imported = import_file(path, ImportOptions(columns={"displacement_m": "weight_N"}))
    np.testing.assert_allclose(only(imported).position, F)
    assert "'weight_N' is taken as displacement in m" in imported.notes[0]


def test_text_runs_get_numbers_in_order_of_appearance(contact):
    path = contact(run=["b"] * 20 + ["a"] * 30, time_s=np.concatenate([T[:20], T[:30]]))
    imported = import_file(path)
    assert imported.run_labels == {0: "b", 1: "a"}
    np.testing.assert_array_equal(only(imported).run, [0] * 20 + [1] * 30)


def test_numbered_runs_keep_their_numbers_and_are_put_together(contact):
    run = np.tile([7, 3], 25)
    channel = only(import_file(contact(run=run)))
    np.testing.assert_array_equal(channel.run, [3] * 25 + [7] * 25)
    np.testing.assert_allclose(channel.time_s[:25], T[1::2])


def test_a_header_that_is_endless_is_told_as_such(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(",".join(f"column_{number}" for number in range(100_000)) + "\n1,2\n")
    with pytest.raises(InputError, match=r"wide\.csv: its first line is longer than 1 MiB"):
        import_file(path)


def test_labels_that_are_longer_than_any_number_are_names(contact):
    label = "12345678901234567890"  # more than fits into 64 bits
    imported = import_file(contact(run=[label] * 20 + ["7"] * 30, time_s=np.concatenate([T[:20], T[:30]])))
    assert imported.run_labels == {0: label, 1: "7"}


def test_derivatives_do_not_reach_across_runs(contact):
    x = np.where(np.arange(50) < 25, 0.001, 0.05)
    channel = only(import_file(contact(run=[0] * 25 + [1] * 25, displacement_m=x)))
    np.testing.assert_allclose(channel.velocity, 0.0, atol=1e-12)


def test_phases_by_name_or_number(contact):
    channel = only(import_file(contact(phase=["loading"] * 25 + ["4"] * 25)))
    np.testing.assert_array_equal(channel.phase, [Phase.LOADING] * 25 + [Phase.HOLD] * 25)


def test_a_given_velocity_and_acceleration_are_kept(contact):
    velocity = 0.009 * np.cos(9 * T)
    channel = only(import_file(contact(velocity_mm_s=1e3 * velocity, acceleration_m_s2=np.full(50, 0.5))))
    np.testing.assert_allclose(channel.velocity, velocity)
    np.testing.assert_allclose(channel.acceleration, 0.5)


@pytest.mark.parametrize("derive", ["gradient", "backward", "tachometer"])
def test_a_velocity_that_is_a_difference_of_the_positions_is_derived_again(tmp_path, derive):
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
        assert "column 'velocity_rad_s' is a difference" in found.notes[0]


def test_where_chooses_rows_and_context_keeps_signals(contact):
    path = contact(specimen=["P1"] * 30 + ["P2"] * 20, temperature_C=20 + T)
    channel = only(import_file(path, ImportOptions(where={"specimen": "P1"}, context=("temperature_C",))))
    assert len(channel) == 30
    np.testing.assert_allclose(channel.context["temperature_C"], 20 + T[:30])


@pytest.mark.parametrize("name", ["joint_velocity", "load"])
def test_a_context_cannot_take_the_place_of_what_belongs_to_the_joints(contact, name):
    path = contact(**{name: 20 + T})
    assert "rename the column" in refusal(path, context=(name,))
    assert import_file(path).unused == ()


def test_two_columns_of_the_context_cannot_become_one_signal(contact):
    path = contact(**{"temp (C)": 20 + T, "temp [C]": 25 + T})
    assert "rename one" in refusal(path, context=("temp (C)", "temp [C]"))


@pytest.mark.parametrize("column", ["température à l'air", "°", "a" * 80])
def test_a_session_holds_a_context_whatever_its_column_is_called(contact, tmp_path, column):
    imported = import_file(contact(**{column: 20 + T}), ImportOptions(context=(column,)))
    place = tmp_path / "kept.mcap"
    write_session(place, import_streams(imported), SessionMetadata(), ())
    (after,) = open_source(place).channels
    (signal,) = after.recorded
    np.testing.assert_allclose(after.context[signal], 20 + T)


def test_columns_of_numbers_that_nothing_was_made_of_are_told(contact):
    path = contact(specimen=["P1"] * 50, temperature_C=20 + T, humidity=40 + T, tool=np.full(50, 3.0))
    assert import_file(path).unused == ("temperature_C", "humidity")
    assert import_file(path, ImportOptions(context=("humidity",))).unused == ("temperature_C",)


def test_an_angle_in_degrees_is_a_position_in_radians(tmp_path):
    swing = {"time_s": T, "angle_deg": np.degrees(np.sin(9 * T)), "torque_Nm": F}
    assert only(import_file(write_csv(tmp_path / "swing.csv", swing))).position == pytest.approx(
        np.sin(9 * T)
    )


def test_an_angle_that_says_no_unit_may_be_of_anything(contact):
    assert import_file(contact(angle=T)).unused == ("angle",)


def test_names_in_lower_case_and_a_depth_are_understood(tmp_path):
    plain = {"time_s": T, "depth_mm": 1e3 * X, "force_n": F}
    channel = only(import_file(write_csv(tmp_path / "plain.csv", plain)))
    assert channel.kind is ChannelKind.CONTACT
    np.testing.assert_allclose(channel.position, X)
    np.testing.assert_allclose(channel.effort, F)


def test_an_empty_or_bad_number_is_named_by_row_and_column(contact):
    force = F.astype(object)
    force[16] = "oops"
    assert "row 17, column 'force_N': 'oops' is no finite number; remove such rows" in refusal(
        contact(force_N=force)
    )
    force[16] = ""
    assert "row 17, column 'force_N'" in refusal(contact(force_N=force))
    force[16:19] = "nan"
    assert "row 17, column 'force_N': 'nan' is no finite number (2 more like it)" in refusal(
        contact(force_N=force)
    )
    force[16:19] = "1,5"
    assert "row 17 has 4 cells and the header 3" in refusal(contact(force_N=force))


def test_row_numbers_are_those_of_the_file_after_a_choice_of_rows(contact):
    force = F.astype(object)
    force[40] = "inf"
    path = contact(force_N=force, specimen=["P1"] * 30 + ["P2"] * 20)
    assert "row 41, column 'force_N'" in refusal(path, where={"specimen": "P2"})


def test_nulls_in_parquet_are_named(tmp_path):
    path = tmp_path / "holes.parquet"
    force = [*F[:10].tolist(), None, *F[11:].tolist()]
    pa.parquet.write_table(pa.table({"time_s": T, "displacement_m": X, "force_N": force}), path)
    assert "row 11, column 'force_N': 'None' is no finite number" in refusal(path)


def test_times_must_increase_within_a_run(contact):
    time_s = T.copy()
    time_s[30:] -= 0.2
    text = refusal(contact(time_s=time_s))
    assert "row 31, column 'time_s': 0.1 s does not come after 0.29 s in row 30" in text
    assert "--column run=COLUMN" in text
    only(import_file(contact(time_s=time_s, run=[0] * 30 + [1] * 20)))
    assert "of run 'two'" in refusal(contact(time_s=np.zeros(50), run=["one"] + ["two"] * 49))


def test_a_missing_column_says_what_is_needed_and_what_is_there(contact):
    text = refusal(contact(force_N=None))
    assert "a contact needs time_s, displacement_m, force_N" in text
    assert "time_s, displacement_m" in text
    assert "--column force_N=COLUMN" in text
    assert "no time; name it time_s" in refusal(contact(time_s=None))


def test_a_column_that_is_not_there_lists_those_that_are(contact):
    assert "has only time_s, displacement_m, force_N" in refusal(contact(), columns={"force_N": "load"})
    text = refusal(contact(), where={"specimn": "P1"})
    assert "no column 'specimn'" in text
    assert "no such row. There are: P1" in refusal(contact(specimen=["P1"] * 50), where={"specimen": "P2"})


def test_units_that_cannot_be_are_refused(contact):
    assert "'force' does not say its unit; say it, as in --unit force=N" in refusal(
        contact(force_N=None, force=F)
    )
    text = refusal(contact(time_s=None, force_N=None, force=F, time=T))
    assert "do not say their units; say them, as in --unit force=N --unit time=s" in text
    assert "measures no displacement" in refusal(contact(), units={"displacement": "N"})
    assert "Valid: " in refusal(contact(), units={"displacement": "furlong"})
    assert "no such quantity or column is in use" in refusal(contact(), units={"torque": "Nm"})
    assert "no quantity with its unit" in refusal(contact(), columns={"weight_N": "force_N"})


def test_two_columns_for_one_quantity_are_ambiguous(contact):
    text = refusal(contact(displacement_mm=1e3 * X))
    assert "'displacement_m' and 'displacement_mm' both hold displacement" in text
    chosen = ImportOptions(columns={"displacement_m": "displacement_mm"})
    np.testing.assert_allclose(only(import_file(contact(displacement_mm=2e3 * X), chosen)).position, 2 * X)


def test_a_velocity_in_the_wrong_unit_is_noticed(contact):
    velocity = 0.009 * np.cos(9 * T)
    text = refusal(contact(velocity_m_s=1e3 * velocity))
    assert "column 'velocity_m_s' is 1e+03 times the rate of change of 'displacement_m'" in text


@pytest.mark.parametrize("share", [-1.0, -0.97])
def test_a_velocity_of_the_wrong_sign_is_refused(tmp_path, share):
    velocity = share * 0.009 * np.cos(9 * T)
    columns = {"time_s": T, "position_rad": 0.001 * np.sin(9 * T), "velocity_rad_s": velocity, "torque_Nm": F}
    text = refusal(write_csv(tmp_path / "joint.csv", columns))
    assert f"column 'velocity_rad_s' is {share:.3g}" in text
    assert "wrong sign" in text


def test_units_of_position_and_velocity_must_go_together(tmp_path):
    columns = {"time_s": T, "position_rad": X, "velocity_m_s": X, "torque_Nm": F}
    assert "units that do not go together" in refusal(write_csv(tmp_path / "mixed.csv", columns))


def test_a_run_that_is_too_short_is_named(contact):
    text = refusal(contact(run=["long"] * 47 + ["short"] * 3))
    assert "run 'short' has 3 rows, at least 5" in text


def test_an_unknown_phase_lists_the_known_ones(contact):
    assert "row 2, column 'phase': no phase is called 'squeeze'. Valid: idle" in refusal(
        contact(phase=["hold", "squeeze"] + ["hold"] * 48)
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.csv", b"", "no rows of data"),
        ("header.csv", b"time_s,displacement_m,force_N\n", "no rows of data"),
        ("numbers.csv", b"0,1,2\n1,2,3\n", "first line holds numbers"),
        ("twice.csv", b"time_s,force_N,force_N\n1,2,3\n", "column 'force_N' is there twice"),
        ("ragged.csv", b"time_s,displacement_m,force_N\n0,1,2\n1,2\n", "row 2 has 2 cells and the header 3"),
        (
            "torn.csv.gz",
            gzip.compress(b"time_s,displacement_m,force_N\n" + b"1,2,3\n" * 9, mtime=0)[:25],
            "cannot be read",
        ),
        ("not.csv.gz", b"time_s,displacement_m,force_N\n0,1,2\n", "cannot be read"),
        ("binary.csv", bytes(range(256)), "is no UTF-8 text"),
        ("broken.parquet", b"PAR1 nonsense", "cannot be read"),
        ("broken.npz", b"PK nonsense", "cannot be read"),
        ("data.xlsx", b"PK", "unknown kind of file"),
    ],
)
def test_broken_files_get_one_line(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    text = refusal(path)
    assert message in text
    assert str(path) in text


def test_arrays_of_objects_are_not_unpickled(tmp_path):
    path = tmp_path / "objects.npz"
    np.savez(path, time_s=np.array([{"a": 1}], dtype=object))
    assert "column 'time_s' holds objects" in refusal(path)


def test_arrays_of_different_length(tmp_path):
    path = tmp_path / "uneven.npz"
    np.savez(path, time_s=T, displacement_m=X[:-1], force_N=F)
    assert "different lengths" in refusal(path)


def test_a_file_that_is_not_there(tmp_path):
    assert "no such file" in refusal(tmp_path / "absent.csv")


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
        import_file(write_csv(path, {"time_s": time_s, "displacement_m": force, "force_N": force}))
    )
    np.testing.assert_array_equal(channel.effort, force)
    assert np.isfinite(channel.acceleration).all()


def test_pairs():
    assert parse_pairs(["force_N = load", "run=log"], "--column") == {"force_N": "load", "run": "log"}
    for wrong in (["force_N"], ["=load"], ["force_N="]):
        with pytest.raises(InputError, match=r"--column .*write it as NAME=VALUE"):
            parse_pairs(wrong, "--column")
    with pytest.raises(InputError, match="is given twice"):
        parse_pairs(["a=1", "a=2"], "--unit")


TEXT = "time_s,displacement_m,force_N\n" + "".join(f"{i / 100},{0.001 * i},{i}\n" for i in range(9))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT.replace("\n0.03,0.003,3", "\n0.03,0.003"), "row 4 has 2 cells and the header 3: '0.03,0.003'"),
        (TEXT.replace("\n0.03,", "\n0.03,7,"), "row 4 has 4 cells and the header 3"),
        (TEXT.replace(",", ";").replace(".", ","), "with a decimal point, not a comma"),
        (TEXT.replace("\n0.03,", "\n1_0,"), "row 4, column 'time_s': '1_0' is no finite number"),
        (TEXT.replace(",3\n", ",1e300\n"), "row 4, column 'force_N': '1e300' is too large a number"),
        ("<html>404</html>", "no rows of data"),
        (TEXT.encode("utf-16"), "is no UTF-8 text; save it as CSV in UTF-8"),
        (TEXT.splitlines()[0] + "\n" + "1" * 3_000_000 + "\n", "a line is longer than 1 MiB"),
    ],
)
def test_a_broken_text_file_is_refused_with_row_and_remedy(tmp_path, text, words):
    file = tmp_path / "broken.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert words in refusal(file)


def test_a_file_of_very_many_columns_is_refused_briefly(tmp_path):
    file = tmp_path / "wide.csv"
    file.write_text(",".join(f"c{i}" for i in range(2_000)) + "\n" + ",".join("0" * 2_000) + "\n")
    text = refusal(file)
    assert "c19 and 1980 more" in text
    assert len(text) < 600


@pytest.mark.parametrize("name", ["big.csv", "big.csv.gz", "big.npz", "big.parquet"])
def test_what_would_fill_the_memory_is_refused(tmp_path, monkeypatch, contact, name):
    for module in (text_table, table):
        monkeypatch.setattr(module, "MOST_BYTES", 500)
    file = tmp_path / name
    if name.endswith(".npz"):
        np.savez_compressed(file, time_s=T, displacement_m=X, force_N=0 * F)
    elif name.endswith(".parquet"):
        pyarrow.parquet.write_table(pa.table({"time_s": T, "displacement_m": X, "force_N": F}), file)
    else:
        content = contact().read_bytes()
        file.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    assert "cut it into pieces" in refusal(file)


@pytest.mark.parametrize("name", ["time_s", "displacement_m", "force_N", "run"])
def test_a_context_is_no_column_that_the_channel_is_made_of(contact, name):
    said = refusal(contact(run=np.zeros(50, int), heat=T**2), context=(name,))
    assert said.startswith(f"--context {name}: the channel is made of that column")
    assert said.endswith("heat")


def test_fresh_runs_begin_with_the_clock_at_zero_and_keep_their_motion(contact, tmp_path):
    run = np.repeat([3, 5], 25)
    path = contact(time_s=T + 7.0, run=run)
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
