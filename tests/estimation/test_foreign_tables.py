"""Tables by people: number marks, equal columns, coarse clocks, odd rows."""

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.column_names import guess_column, split_unit
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.presses import press_phases
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import FORCE_N, TIME_S, WAY_M, by_the_advice, lines
from tests.files import saved, write_csv


def table_file(folder, header, *columns, **form):
    """A table of numbers below the lines of its header."""
    return saved(folder / "table.csv", header + lines(*columns, **form))


@pytest.mark.parametrize(
    ("mark", "quote"), [("\u00a0", '"'), ("\u202f", ""), (" ", '"'), (" ", ""), (".", "")]
)
def test_blanks_separate_thousands(tmp_path, mark, quote):
    force = 1e5 * FORCE_N
    cells = [f"{value:,.2f}".translate({44: mark, 46: ","}) for value in force]
    rows = zip(TIME_S, 1e3 * WAY_M, cells, strict=True)
    text = "".join(
        ";".join(
            quote + cell + quote for cell in (f"{t:.4f}".replace(".", ","), f"{x:.6f}".replace(".", ","), f)
        )
        + "\n"
        for t, x, f in rows
    )
    path = saved(tmp_path / "table.csv", "Time [s];Extension [mm];Load [N]\n" + text)
    (channel,) = import_file(path).channels
    assert len(channel) == len(TIME_S)
    np.testing.assert_allclose(channel.effort, force, atol=0.006)


@pytest.mark.parametrize(
    ("header", "write"),
    [
        ("t [s];Travel [um];Load [mN]", lambda value: f"{value:,.3f}".replace(",", "'")),
        ("t [s];Travel [um];Load [mN]", lambda value: f"{value:,.3f}".replace(",", "\u2019")),
        ("t [s];Travel [um];Load [mN]", lambda value: f"{value:.3f}".replace("-", "\u2212")),
        ("t [s];Travel [um];Load [mN]", lambda value: f"{value:.7E}".replace("E", "D")),
        ("t [s],Travel [um],Load [mN]", lambda value: f'"{value:,.3f}"'),
    ],
)
def test_numbers_with_apostrophes_minus_signs_and_exponents_of_fortran(tmp_path, header, write):
    cells = ([write(value) for value in row] for row in zip(TIME_S, 1e6 * WAY_M, 1e3 * FORCE_N, strict=True))
    text = "".join((";" if ";" in header else ",").join(row) + "\n" for row in cells)
    (channel,) = import_file(saved(tmp_path / "table.csv", f"{header}\n{text}")).channels
    np.testing.assert_allclose(channel.position, WAY_M, atol=1e-8)
    np.testing.assert_allclose(channel.effort, FORCE_N, atol=1e-5)


def test_commas_group_thousands_where_hundreds_have_none_and_points_are_decimal(tmp_path):
    cells = (f"{t:.4f};{1e6 * x:,.0f};{f:.6f}\n" for t, x, f in zip(TIME_S, WAY_M, FORCE_N, strict=True))
    path = saved(tmp_path / "table.csv", f"t [s];Travel [um];Load [N]\n{''.join(cells)}")
    np.testing.assert_allclose(import_file(path).channels[0].position, WAY_M, atol=1e-6)


SWING_RAD = 0.8 + 0.4 * np.sin(6.0 * TIME_S)
TORQUE_NM = 3.0 * np.sin(6.0 * TIME_S)


def test_equal_columns_in_two_units_are_read_once(tmp_path):
    columns = (TIME_S, np.degrees(SWING_RAD), SWING_RAD, TORQUE_NM)
    path = table_file(tmp_path, "time_s,position_degrees,position_radians,torque_Nm\n", *columns)
    imported = import_file(path)
    np.testing.assert_allclose(imported.channels[0].position, SWING_RAD, atol=1e-6)
    assert "'position_degrees' and 'position_radians' hold the same position" in imported.notes[0]
    columns = (TIME_S, np.degrees(SWING_RAD), 0.5 * SWING_RAD, TORQUE_NM)
    path.write_text("time_s,position_degrees,position_radians,torque_Nm\n" + lines(*columns))
    np.testing.assert_allclose(by_the_advice(path).channels[0].position, SWING_RAD, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "columns", "kind", "position", "effort"),
    [
        (  # it asks for the force's lever arm
            *("angle_deg,force_feedback", (np.degrees(SWING_RAD), TORQUE_NM)),
            *(ChannelKind.REVOLUTE, SWING_RAD, 0.1 * TORQUE_NM),
        ),
        (
            "a:output_position,a:motor_position,a:joint_position,a:motor_current,torque",
            (SWING_RAD, 9.0 * SWING_RAD, 0.0 * TIME_S, TORQUE_NM, 5.0 * TORQUE_NM),
            *(ChannelKind.REVOLUTE, SWING_RAD, 5.0 * TORQUE_NM),
        ),
    ],
)
def test_missing_ambiguous_and_unitless_columns_are_asked_for(
    tmp_path, names, columns, kind, position, effort
):
    (channel,) = by_the_advice(table_file(tmp_path, f"log:timestamp,{names}\n", TIME_S, *columns)).channels
    assert channel.kind is kind
    np.testing.assert_allclose(channel.time_s, TIME_S, atol=1e-6)
    np.testing.assert_allclose(channel.position, position, atol=1e-6 * np.ptp(position))
    np.testing.assert_allclose(channel.effort, effort, atol=1e-6)


def test_step_clock_gives_no_runs(tmp_path):
    step = np.concatenate([np.arange(200), np.arange(200), np.arange(200)]) * 0.01
    way = np.concatenate([np.linspace(0.0, 2.0, 200), np.full(200, 2.0), np.linspace(2.0, 0.0, 200)])
    path = tmp_path / "steps.csv"
    rows = lines(np.arange(600) * 0.01, step, way, 30.0 * way)
    path.write_text("Total Time (s),Step Time (s),Extension (mm),Load (N)\n" + rows)
    (channel,) = import_file(path).channels
    assert len(channel.runs) == 1


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        ("Position des Kolbens (mm)", "position"),
        ("Joint des Position (rad)", "goal"),
        ("q des (rad)", "goal"),
        ("Position des [mm]", ""),
    ],
)
def test_german_des_is_not_desired(name, quantity):
    assert guess_column(name).quantity == quantity


def test_longest_sheet_with_a_measurement_is_read(tmp_path):
    book = openpyxl.Workbook()
    book.active.append(["Elapsed [ms]", "Byte0", "Byte1"])
    for place in range(900):
        book.active.append([place * 5.0, place % 255, 7])
    sheet = book.create_sheet("Press")
    sheet.append(["Elapsed Time [ms]", "Extension [mm]", "Load [N]"])
    for t, x, f in zip(TIME_S, WAY_M, FORCE_N, strict=True):
        sheet.append([1e3 * t, 1e3 * x, f])
    book.save(tmp_path / "two.xlsx")
    (channel,) = import_file(tmp_path / "two.xlsx").channels
    np.testing.assert_allclose(channel.effort, FORCE_N)


@pytest.mark.parametrize(("rate_hz", "noise_m"), [(20.0, 0.0), (100.0, 1e-5), (1000.0, 1e-5)])
def test_sine_has_no_hold_and_a_hold_is_kept(rate_hz, noise_m):
    time_s = np.arange(0.0, 20.0, 1.0 / rate_hz)
    run, pressed = np.zeros(len(time_s), dtype=np.int64), np.ones(len(time_s), dtype=np.bool_)
    noise = np.random.default_rng(0).normal(0.0, noise_m, len(time_s))

    def held(way):
        depth = 1e-3 * (1.2 + way) + noise
        velocity = differentiate(time_s, depth, run).velocity
        return np.mean(press_phases(depth, velocity, 500.0 * depth, run, pressed) == Phase.HOLD)

    assert held(np.sin(np.pi * time_s)) < 0.015
    assert held(2.0 / np.pi * np.arcsin(np.sin(np.pi * time_s))) < 0.005
    assert held(np.clip(1.5 * np.sin(0.2 * np.pi * time_s), -1.0, 1.0)) > 0.35  # of 0.54 that are clipped
    late_s = np.maximum(time_s - 1.0, 0.0)
    assert held(1.0 - np.cos(np.pi * late_s)) > 0.04 - 2.0 / len(time_s)  # of 0.05 before the sine begins


def test_time_that_is_not_of_the_rows_may_be_left_out(tmp_path):
    done = np.repeat(np.arange(60.0), 10)
    path = table_file(tmp_path, "completion_time_s,depth_m,force_N\n", done, WAY_M, FORCE_N, form="{:.8f}")
    (note,) = (note for note in import_file(path).notes if "repeats times" in note)
    assert note.endswith("add --context completion_time_s to read it as another signal")
    (channel,) = import_file(path, ImportOptions(context=("completion_time_s",))).channels
    np.testing.assert_allclose(channel.position, WAY_M, atol=1e-7)
    np.testing.assert_allclose(np.diff(channel.time_s), 1.0)


def test_rows_of_one_second_are_spread_over_it(tmp_path):
    path = table_file(tmp_path, "time_s,depth_m,force_N\n", np.floor(TIME_S * 20.0) / 20.0, WAY_M, FORCE_N)
    (channel,) = import_file(path).channels
    assert np.abs(channel.time_s - TIME_S).max() < 0.05 + 1e-6
    assert np.diff(channel.time_s).min() > 0.0


def test_joint_is_called_by_its_columns(tmp_path):
    columns = (TIME_S, SWING_RAD, TORQUE_NM, -SWING_RAD, TORQUE_NM)
    names = "time [s],knee angle [rad],knee torque [Nm],hip angle [rad],hip torque [Nm]\n"
    path = table_file(tmp_path, names, *columns)
    imported = import_file(path)
    assert imported.title("joint_2") == "joint_2 of 'hip angle [rad]' and 'hip torque [Nm]'"
    path.write_text("time_s,position_rad,torque_Nm\n" + lines(*columns[:3]))
    assert import_file(path).title("joint_1") == "joint_1"


def test_two_sided_force_deep_inside_is_that_of_an_axis(tmp_path):
    force = np.where(np.gradient(WAY_M) < 0.0, -FORCE_N, FORCE_N)
    path = table_file(tmp_path, "Time [s],Extension [mm],Load [N]\n", TIME_S, 1e3 * np.abs(WAY_M), force)
    imported = import_file(path)
    assert imported.channels[0].name == "joint_1"
    assert "to read them as a contact, add --column displacement='Extension [mm]'" in " ".join(imported.notes)
    path.write_text("Time [s],Extension [mm],Load [N]\n" + lines(TIME_S, 1e3 * np.abs(WAY_M), FORCE_N))
    assert import_file(path).channels[0].name == "contact"


def test_tearing_strip_is_pulled_though_its_force_then_falls(tmp_path):
    way = np.linspace(0.0, 20.0, 800)
    force = np.where(way < 9.0, 0.3 * way + 0.02 * way**2, np.maximum(4.3 - 0.6 * (way - 9.0), 0.0))
    path = table_file(tmp_path, "Time [s],Position [mm],Fz [N]\n", np.linspace(0.0, 200.0, 800), -way, -force)
    assert import_file(path).channels[0].name == "contact"
    dragged = np.full(800, 2.0) + 0.01 * np.sin(way)  # an axis needs its force from the first movement on
    path.write_text("Time [s],Position [mm],Fz [N]\n" + lines(np.linspace(0.0, 200.0, 800), way, dragged))
    assert import_file(path).channels[0].name == "joint_1"


@pytest.mark.parametrize(("step", "count", "unit"), [(0.526, 200, "s"), (2.0, 4000, "ms"), (0.01, 300, "s")])
def test_time_without_a_unit_is_no_shorter_than_a_press(tmp_path, step, count, unit):
    time, way = step * np.arange(count), np.linspace(0.0, 1.0, count)
    path = table_file(tmp_path, "Time,Travel [mm],Load [N]\n", time, way, 3.0 * way + 0.1 * way**2)
    assert f"is read in {unit}, as its sample step suggests;" in import_file(path).notes[0]


@pytest.mark.parametrize("runs", [1, 2])
def test_run_number_may_follow_the_unit(tmp_path, runs):
    way, force = np.linspace(0.0, 5e-3, 200), np.linspace(0.0, 5.0, 200)
    names = ",".join(f'"Position (m) Run #{n}","Force (N) Run #{n}"' for n in range(1, runs + 1))
    (channel,) = import_file(table_file(tmp_path, names + "\n", *(way, force) * runs)).channels
    assert (channel.name, len(channel.runs), channel.position.max()) == ("contact", runs, pytest.approx(5e-3))
    assert split_unit("Force (N) Test 10Hz filtered")[1] == ""  # but it may be part of a name


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), (" ", ","), ("\t", ".")])
def test_unnamed_columns_are_called_by_their_places(tmp_path, delimiter, decimal):
    text = lines(TIME_S, 1e3 * WAY_M, FORCE_N, delimiter=delimiter).replace(".", decimal)
    path = saved(tmp_path / "bare.txt", text)
    with pytest.raises(
        InputError, match=r"no column names; its first row is 0.0+, .*--column time='column 1'"
    ):
        import_file(path)
    columns = {"time": "column 1", "displacement": "column 2", "force": "column 3"}
    options = ImportOptions(columns=columns, units={"time": "s", "displacement": "mm", "force": "N"})
    (channel,) = import_file(path, options).channels
    np.testing.assert_allclose(channel.position, WAY_M, atol=1e-8)


LIST = "%% log\n%  1  time 0.010 sec\n%  2 3 Travel [mm] left, right: 1.0 2.0\n% 5 Load (1 = raw)\n"


@pytest.mark.parametrize(
    ("above", "row", "names"),
    [
        (LIST, "{0} {1} {1} 7 {2}", ["time", "Travel left [mm]", "Travel right [mm]", "column 4", "Load"]),
        ("", "Tick{3} {0} Travel {1} {1} Load {2}", ["Tick", "Travel 1", "Travel 2", "Load"]),
    ],
)
def test_words_beside_numbers_name_the_columns(tmp_path, above, row, names):
    rows = (row.format(*cells) for cells in zip(TIME_S, 1e3 * WAY_M, FORCE_N, range(9999), strict=False))
    table = read_table(saved(tmp_path / "log.txt", above + "\n".join(rows)))
    assert [name for name in table.names if above or table.numeric_share(name)] == names
    np.testing.assert_allclose(table.numbers("Load"), FORCE_N)


def test_missing_position_is_integrated_from_the_velocity(tmp_path):
    speed = np.gradient(SWING_RAD, TIME_S)
    path = table_file(tmp_path, "time [s],torque [Nm],angular speed [rad/s]\n", TIME_S, TORQUE_NM, speed)
    imported = import_file(path)
    (channel,) = imported.channels
    assert channel.kind is ChannelKind.REVOLUTE
    np.testing.assert_allclose(channel.position, SWING_RAD - SWING_RAD[0], atol=2e-3 * np.ptp(SWING_RAD))
    np.testing.assert_allclose(channel.velocity, speed, atol=1e-6)
    assert any("the position is integrated from 'angular speed [rad/s]'" in note for note in imported.notes)
    assert not any("steady state" in note for note in imported.notes)
    steady = import_file(table_file(tmp_path, "torque [Nm],angular speed [rad/s]\n", TORQUE_NM, speed))
    assert any("only effects of 'angular speed [rad/s]' can be trusted" in note for note in steady.notes)


def test_velocity_is_read_with_a_user_unit(tmp_path):
    t = np.linspace(0.0, 10.0, 1000)
    path = table_file(
        tmp_path, "Time,Position,Velocity,Iq\n", t, np.sin(t), 1.01 * np.cos(t), 0.1 * np.cos(t)
    )
    units = {"position": "rad", "torque": "A"}
    (derived,) = import_file(path, ImportOptions(units=units)).channels
    (read,) = import_file(path, ImportOptions(units=units | {"velocity": "rad_s"})).channels
    assert (derived.velocity.max(), read.velocity.max()) == (
        pytest.approx(1.0, abs=1e-3),
        pytest.approx(1.01),
    )


def test_late_stamped_rows_are_spread_over_the_gap_before_them(tmp_path):
    """A logger slept for six steps, and stamped what came meanwhile in quick succession."""
    t = 1e-3 * np.arange(2000)
    stamped = t.copy()
    stamped[500:506] = t[506] - 1e-4 * np.arange(6, 0, -1)
    lost = np.where(np.arange(2000) < 1500, stamped, stamped + 4e-3)  # four rows are lost, and none is late
    path = table_file(tmp_path, "Time,Position,Iq\n", lost, np.sin(5.0 * t), np.cos(5.0 * t))
    found = import_file(path, ImportOptions(units={"position": "rad", "torque": "A", "time": "s"}))
    (channel,) = found.channels
    np.testing.assert_allclose(channel.time_s, np.where(np.arange(2000) < 1500, t, t + 4e-3), atol=1e-9)
    assert any("stamps 6 of 2000 rows late" in note for note in found.notes)


def test_remarks_may_state_names_and_units_of_columns(tmp_path):
    """As an instrument for atomic force microscopy writes its curves."""
    path = tmp_path / "curve.txt"
    head = (
        "# xPosition: 1.2E-5\n# speed: 1.0E-6\n#\n# columns: seriesTime height vDeflection\n"
        '# fancyNames: "Series Time" "Height (measured)" "Vertical deflection"\n# units: s m N\n#\n'
    ) + "# settings.segment.1.value: 1\n" * 300
    path.write_text(head + lines(TIME_S, WAY_M, FORCE_N, delimiter=" ", form="{:.9e}"))
    assert read_table(path).names == ("seriesTime [s]", "height [m]", "vDeflection [N]")
    np.testing.assert_allclose(import_file(path).channels[0].effort, FORCE_N, rtol=1e-8)


def test_joint_named_by_the_user_is_the_only_one(tmp_path):
    path = table_file(tmp_path, "t,q1,tau1,q2,tau2\n", TIME_S, WAY_M, FORCE_N, 2.0 * WAY_M, 3.0 * FORCE_N)
    columns, units = {"position": "q2", "torque": "tau2"}, {"time": "s", "position": "rad", "torque": "Nm"}
    (channel,) = import_file(path, ImportOptions(columns=columns, units=units)).channels
    np.testing.assert_allclose(channel.effort, 3.0 * FORCE_N, atol=1e-5)


def test_position_named_by_the_user_moves_by_the_force(tmp_path):
    columns = {"Time [s]": TIME_S, "Slide [mm]": 1e3 * WAY_M, "Travel [mm]": 2.0 * WAY_M, "Load [N]": FORCE_N}
    file = write_csv(tmp_path / "axis.csv", columns)
    (channel,) = import_file(file, ImportOptions(columns={"position": "Slide [mm]"})).channels
    assert channel.kind is ChannelKind.PRISMATIC
    np.testing.assert_allclose(channel.position, WAY_M)


def test_few_rows_before_a_clock_restart_are_left_out(tmp_path):
    path = tmp_path / "motor.csv"
    rows = lines(np.arange(600), WAY_M, FORCE_N)
    path.write_text("Time [ms],Position [rad],Torque [Nm]\n0.0,0.0,0.0\n1.0,0.0,0.0\n" + rows)
    found = import_file(path)
    assert len(found.channels[0]) == 600
    said = "2 of 602 rows left out: their run has fewer than 5 rows; the first is in line 2"
    assert said in " ".join(found.notes)


@pytest.mark.parametrize("cells", ["{0:.2f} mm,{0:.1f} N", "{0:.2f},{0:.1f} N"])
def test_units_behind_numbers_are_named_as_the_fault(tmp_path, cells):
    path = tmp_path / "typed.csv"
    rows = "".join(f"{0.01 * n:.2f},{cells.format(0.1 * n)}\n" for n in range(150))
    path.write_text("Time [s],Way [mm],Load [N]\n" + rows)
    with pytest.raises(InputError, match=r"write (a|the) unit in the (name of its column|column name)"):
        import_file(path)


def test_last_word_of_a_name_without_unit_determines_the_quantity(tmp_path):
    path = tmp_path / "zwick.txt"
    header = "Test time, Standard travel, Tool separation, Standard force\n"
    path.write_text(header + lines(TIME_S, 1e3 * WAY_M, 25.0 - 1e3 * WAY_M, FORCE_N))
    with pytest.raises(InputError, match="'Standard travel', 'Standard force' state no units"):
        import_file(path)
    (channel,) = by_the_advice(path).channels
    np.testing.assert_allclose(channel.position, WAY_M, atol=1e-9)
    np.testing.assert_allclose(channel.effort, FORCE_N, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (("encoder_1", "torque_1_Nm"), "position=0.00153rad"),
        (("position_1_counts", "torque_1_Nm"), "position=0.00153rad"),
        (("displacement_mm", "force_raw"), "force=0.001N"),
    ],
)
def test_counts_are_asked_for_the_value_of_one(tmp_path, names, unit):
    t = np.arange(400) * 0.01
    counts = np.round(2000.0 * np.sin(t) + 30.0 * t)
    path = write_csv(tmp_path / "log.csv", {"time_s": t, names[0]: counts, names[1]: counts})
    with pytest.raises(InputError, match=f"--unit {unit}, the value of one count$"):
        import_file(path)
    quantity, _, text = unit.partition("=")
    (channel,) = import_file(path, ImportOptions(units={quantity: text})).channels
    read = channel.position if quantity == "position" else channel.effort
    np.testing.assert_allclose(read, counts * (0.00153 if quantity == "position" else 0.001))


@pytest.mark.parametrize("label", ["slow {}", "{}"])
def test_trial_column_names_the_runs(tmp_path, label):
    t = np.tile(np.arange(200) * 0.01, 3)
    x = 0.002 * np.sin(3.0 * t) ** 2
    trials = [label.format(row // 200 + 1) for row in range(600)]
    path = tmp_path / "trials.csv"
    write_csv(path, {"trial": trials, "time_s": t, "displacement_m": x, "force_N": 300.0 * x})
    assert list(import_file(path).run_labels.values()) == [label.format(number) for number in (1, 2, 3)]


@pytest.mark.parametrize("pause_s", [0.0, 20.0])
def test_presses_are_cut_at_a_pause_of_the_logger(tmp_path, pause_s):
    one = np.concatenate([np.zeros(10), np.sin(np.linspace(0.0, np.pi, 150)), np.zeros(40)])
    x = 0.003 * np.tile(one, 3) - 1e-4
    t = np.arange(600) * 0.01 + pause_s * (np.arange(600) // 200)
    path = tmp_path / "presses.csv"
    write_csv(path, {"time_s": t, "displacement_m": x, "force_N": 300.0 * np.maximum(x, 0.0)})
    imported = import_file(path)
    (channel,) = imported.channels
    ends = [int(end) for end in np.flatnonzero(np.diff(channel.run)) + 1]
    assert ends == ([200, 400] if pause_s else [185, 385])
    assert not any("jumps" in note for note in imported.notes)


OWN_NAMES, OTHER_NAMES = ("position_rad", "torque_Nm"), ("q [rad]", "tau [Nm]")


@pytest.mark.parametrize(
    ("ending", "names"), [(".npz", OTHER_NAMES), (".parquet", OTHER_NAMES), (".mat", OWN_NAMES)]
)
def test_matrix_gives_one_channel_per_column(tmp_path, ending, names):
    t = np.arange(300) * 0.01
    q = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t)])
    arrays = {"time_s": t, names[0]: q, names[1]: 0.5 * q, "pose": np.eye(4)}
    path = tmp_path / f"arm{ending}"
    if ending == ".npz":
        np.savez(path, **arrays)
    elif ending == ".mat":
        savemat(path, arrays)
    else:
        del arrays["pose"]
        pq.write_table(pa.table({name: list(array) for name, array in arrays.items()}), path)
    channels = import_file(path).channels
    assert [channel.name for channel in channels] == ["joint_1", "joint_2"]
    np.testing.assert_allclose([channel.effort for channel in channels], 0.5 * q.T)


def test_repeated_column_is_chosen_by_its_number(tmp_path):
    path, t = tmp_path / "twice.csv", np.arange(600) * 0.01
    depth = 2.0 + 2.0 * np.sin(3.0 * t)
    rows = lines(t, depth, 3.0 * depth, 3.1 * depth, delimiter=",")
    path.write_text("time_s,displacement_mm,force_N,force_N\n" + rows)
    with pytest.raises(InputError, match=r"choose with .*force='force_N \(2\)'"):
        import_file(path)
    (channel,) = import_file(path, ImportOptions(columns={"force": "force_N (2)"})).channels
    assert channel.effort == pytest.approx(3.1 * depth, abs=1e-3)


TESTS = np.tile([2.0, 3.5, 5.0], 2)  # thickness of each specimen
ONE_LOADING = np.linspace(0.0, 30.0, 40)  # displacement of one test [mm]


def specimens_table(folder, name):
    """Six tests below each other, without a clock; a column states the thickness of the specimen."""
    thickness = np.repeat(TESTS, len(ONE_LOADING))
    way = np.tile(ONE_LOADING, len(TESTS))
    return table_file(folder, f"{name},Force [N],Disp [mm]\n", thickness, 3.0 * thickness * way, way)


@pytest.mark.parametrize("name", ["T", "t", "thickness"])
def test_parameter_of_the_specimen_is_no_clock(tmp_path, name):
    imported = import_file(specimens_table(tmp_path, name))
    (channel,) = imported.channels
    np.testing.assert_allclose(np.diff(channel.time_s[channel.run == 0]), 1.0)
    assert "if a column holds the time, add --column time=COLUMN" in " ".join(imported.notes)


@pytest.mark.parametrize(
    ("name", "options", "ticks"),
    [
        ("elapsed time", ImportOptions(), 6),
        ("T [s]", ImportOptions(), 6),
        ("T", ImportOptions(units={"T": "s"}), 6),
        ("T", ImportOptions(columns={"time": "T"}), 6),
        ("t", ImportOptions(), 30),  # too many for a parameter
    ],
)
def test_coarse_clock_with_a_clear_name_or_many_ticks_is_the_time(tmp_path, name, options, ticks):
    way = 15.0 - 15.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 240))
    seconds = np.repeat(np.arange(float(ticks)), 240 // ticks)
    path = table_file(tmp_path, f"{name},Force [N],Disp [mm]\n", seconds, 3.0 * way, way)
    (channel,) = import_file(path, options).channels
    np.testing.assert_allclose(np.diff(channel.time_s[channel.run == 0]), ticks / 240.0)
