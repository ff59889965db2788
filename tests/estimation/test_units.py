"""Units in names: prefixes, products, and substitutes for an effort."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.base_model import NO_ARM
from palpate.estimation.data.column_names import guess_column, split_unit
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.units import SI, dimension_of, normalize_unit
from palpate.estimation.data_quality import quality_warnings
from palpate.estimation.study.channels import data_sha256
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import imported

T = np.arange(400) * 0.01
X = 0.004 * (1.0 - np.cos(3.0 * T))
FORCE = 500.0 * X
G = 9.80665


@pytest.mark.parametrize(
    "form",
    [
        *("Load ({})", "Load [{}]", "Load / {}", "load_{}", "Load {}", "Load in {}"),
        *("[{}] Load", "({}) Load", "[{}] Load (cell 2)"),
    ],
)
@pytest.mark.parametrize(
    ("unit", "newtons"),
    [
        ("MN", 1e6),
        ("mN", 1e-3),
        ("kN", 1e3),
        ("KN", 1e3),
        ("nN", 1e-9),
        ("pN", 1e-12),
        ("uN", 1e-6),
        ("µN", 1e-6),  # the micro sign
        ("μN", 1e-6),  # the Greek letter
    ],
)
def test_prefix_is_read_by_its_letter_in_any_notation(form, unit, newtons):
    dimension, factor = factor_of(form.format(unit))
    assert (dimension, factor) == ("force", pytest.approx(newtons, rel=1e-12))


@pytest.mark.parametrize(
    ("name", "dimension", "factor"),
    [
        ("Time (h)", "time", 3600.0),
        ("TIME (MIN)", "time", 60.0),
        ("t_us", "time", 1e-6),
        ("height (nm)", "length", 1e-9),
        ("z (µm)", "length", 1e-6),
        ("Torque NM", "torque", 1.0),
        ("Torque N m", "torque", 1.0),
        ("Torque (kgf cm)", "torque", 0.01 * G),
        ("Torque kgf cm", "torque", 0.01 * G),
        ("Torque [oz-in]", "torque", 0.45359237 * G / 16.0 * 0.0254),
        ("p (psi)", "pressure", 0.45359237 * G / 0.0254**2),
        ("p (bar)", "pressure", 1e5),
        ("bridge [mV]", "voltage", 1e-3),
        ("Speed mm/s", "length_rate", 1e-3),
        ("speed [rpm]", "angle_rate", np.pi / 30.0),
        ("speed [mm/min]", "length_rate", 1e-3 / 60.0),
        ("Load (daN)", "force", 10.0),
        ("Load [cN]", "force", 0.01),
        ("Torque [dNm]", "torque", 0.1),
        ("Torque [in-lbs]", "torque", 0.45359237 * G * 0.0254),
        ("Winkel [gon]", "angle", np.pi / 200.0),
        ("pos_mdeg", "angle", np.pi / 180e3),
        ("力(公斤)", "force", G),
        ("Угол, град", "angle", np.pi / 180.0),
        ("时间(秒)", "time", 1.0),
        ("Load..mN.", "force", 1e-3),  # as R writes "Load (mN)" and "v (mm/s)"
        ("v..mm.s.", "length_rate", 1e-3),
        ("Compression_N", "force", 1.0),  # no indices
        ("M1_A", "current", 1.0),
        ("Scale_g", "force", 1e-3 * G),
        ("1 m", "length", 1.0),
    ],
)
def test_machine_units_are_known(name, dimension, factor):
    assert factor_of(name) == (dimension, pytest.approx(factor, rel=1e-12))


@pytest.mark.parametrize("unit", ["MM", "MS", "MV", "xN", "furlong", "DN", "t", "d", "500 N", "100 N"])
def test_words_are_not_read_as_units(unit):
    assert dimension_of(normalize_unit(unit)) is None


def factor_of(name):
    unit = split_unit(name)[1]
    return dimension_of(unit), SI[dimension_of(unit)][unit]


def test_unit_in_front_of_a_name_is_read_as_one_behind_it():
    behind = imported(**{"Time Elapsed [s]": T, "Travel [um]": 1e6 * X, "Load [N]": FORCE})
    found = imported(**{"[s] Time Elapsed": T, "(um) Travel": 1e6 * X, "[N] Load": FORCE})
    np.testing.assert_array_equal(found.channels[0].position, behind.channels[0].position)
    np.testing.assert_array_equal(found.channels[0].effort, behind.channels[0].effort)
    np.testing.assert_array_equal(found.channels[0].time_s, behind.channels[0].time_s)


def test_units_in_front_of_a_name_and_behind_it_are_both_stated():
    found = imported(**{"Time [s]": T, "[um] Travel [mm]": 1e3 * X, "Load [N]": FORCE})
    np.testing.assert_allclose(found.channels[0].position, X, atol=1e-12)
    assert "column '[um] Travel [mm]' may state two units" in " ".join(found.notes)


@pytest.mark.parametrize("name", ["[1] Load N", "(left) Load N", "[Rig 2] Load_N"])
def test_other_text_in_front_of_a_name_leaves_the_unit_behind_it(name):
    assert factor_of(name) == ("force", 1.0)


@pytest.mark.parametrize(
    ("unit", "scale", "proposed"),
    [
        ("m", 1e3, "--unit displacement=mm"),
        ("mm", 100.0, "if the displacement is not in mm, give its unit with --unit displacement=UNIT"),
    ],
)
def test_deep_indentation_proposes_no_unit_that_is_set(unit, scale, proposed):
    depth = scale * X / SI["length"][unit]
    columns = {"Time [s]": T, "Load [N]": FORCE}
    by_header = imported(**columns, **{f"Travel [{unit}]": depth})
    by_option = imported(ImportOptions(units={"displacement": unit}), **columns, Travel=depth)
    for found in (by_header, by_option):
        (warning,) = (said for said in quality_warnings(found.channels[0]) if "deepest" in said)
        assert warning.endswith(proposed)


@pytest.mark.parametrize(
    ("units", "scale", "remedy"),
    [
        (("m", "N"), 1e6, "correct it, such as --unit force=mN"),
        (("mm", "kN"), 1e6, "correct it with --unit"),
        (("m", "N"), 1e-6, "correct it, such as --unit displacement=mm or --unit force=kN"),
        (("mm", "N"), 1e-6, "correct it, such as --unit force=kN"),
    ],
)
def test_units_proposed_for_an_implausible_stiffness_make_it_more_plausible(units, scale, remedy):
    depth, force = X / SI["length"][units[0]], scale * FORCE / SI["force"][units[1]]
    found = imported(**{"Time [s]": T, f"Travel [{units[0]}]": depth, f"Load [{units[1]}]": force})
    (warning,) = (said for said in quality_warnings(found.channels[0]) if "force over depth" in said)
    assert warning.endswith(remedy)


@pytest.mark.parametrize(
    ("time", "angle", "remedy"),
    [
        ("s", "rad", "; if the angle is in degrees, use --unit position=deg"),
        ("s", "deg", "; check the unit of the time"),
        ("ms", "deg", "; if the time is in seconds, use --unit time=s"),
    ],
)
def test_only_units_that_make_a_joint_slower_are_proposed(time, angle, remedy):
    turns = 1e5 * np.sin(3.0 * T) / SI["angle"][angle]
    found = imported(**{f"Time [{time}]": T, "Torque [Nm]": np.cos(3.0 * T), f"Angle [{angle}]": turns})
    (warning,) = (said for said in quality_warnings(found.channels[0]) if "turns faster" in said)
    assert warning.endswith(remedy)


@pytest.mark.parametrize(
    ("unit", "step", "proposed"),
    [
        ("s", 800.0, "ms"),
        ("s", 10.0, "ms"),
        ("s", 4e3, "us"),
        ("s", 4e6, "ns"),
        ("ms", 800.0, "us"),  # 0.8 s in the unit that is set
        ("s", 1e-6, "h"),  # in minutes, the recording would last 0.02 s
    ],
)
def test_time_unit_that_is_proposed_gives_a_plausible_step(unit, step, proposed):
    count = np.arange(len(T))
    found = imported(**{f"Time [{unit}]": step * count, "Travel [mm]": 1e3 * X, "Load [N]": FORCE})
    (note,) = (said for said in found.notes if "apart; if the unit of time is wrong" in said)
    assert note.endswith(f"--unit time={proposed}")


def test_unit_of_the_file_does_not_distinguish_data():
    (channel,) = imported(**{"Time [s]": T, "Travel [mm]": 1e3 * X, "Load [N]": FORCE}).channels
    assert channel.units == {"time": "s", "displacement": "mm", "force": "N"}
    assert data_sha256(channel, NO_ARM) == data_sha256(replace(channel, units={}), NO_ARM)


def test_units_become_si_and_nm_depends_on_its_partner():
    found = imported(**{"Time (h)": T / 3600.0, "Travel (mm)": 1e3 * X, "Load (MN)": 1e-6 * FORCE})
    (channel,) = found.channels
    np.testing.assert_allclose(channel.time_s, T, atol=1e-12)
    np.testing.assert_allclose(channel.effort, FORCE)
    (press,) = imported(time_s=T, displacement_nm=1e9 * X, force_N=FORCE).channels
    np.testing.assert_allclose(press.position, X)
    (joint,) = imported(time_s=T, position_rad=X, torque_nm=FORCE).channels
    np.testing.assert_allclose(joint.effort, FORCE)
    (joint,) = imported(**{"t [s]": T, "angle [rad]": X, "Torque [nm]": FORCE}).channels
    np.testing.assert_allclose(joint.effort, FORCE)


@pytest.mark.parametrize(
    ("column", "unit", "newtons"),
    [
        ("Load cell [mV]", "20N/V", 0.02),
        ("Load cell [mV]", "0.02N/mV", 0.02),
        ("Load [kPa]", "5e-4N/Pa", 0.5),
        ("Load [psi]", "2N/psi", 2.0),
        ("Load [bar]", "5e-4N/Pa", 50.0),
        ("load", "20N/V", 20.0),  # of no unit: it is in what the constant is per
    ],
)
def test_voltage_or_pressure_is_converted_to_force_by_a_constant(column, unit, newtons):
    options = ImportOptions(units={"force": unit})
    (press,) = imported(options, **{"t [s]": T, "Travel [m]": X, column: FORCE}).channels
    np.testing.assert_allclose(press.effort, newtons * FORCE)


@pytest.mark.parametrize(
    ("column", "newtons"),
    [
        *(
            ("Load [0.1 N]", 0.1),
            ("Load [10^-3 N]", 1e-3),
            ("Load (x10^-1 N)", 0.1),
            ("Load (1/100 kN)", 10.0),
        ),
        *(("Load [V] (5 N/V)", 5.0), ("Load [mV] (5 N/V)", 5e-3), ("Load (0.2 V/N) [V]", 5.0)),
    ],
)
def test_factor_or_sensitivity_in_a_name_is_applied_and_noted(column, newtons):
    press = {"t [s]": T, "Travel [m]": X, column: FORCE}
    found = imported(**press)
    np.testing.assert_allclose(found.channels[0].effort, newtons * FORCE)
    assert f"the factor in the name of column '{column}' is applied" in " ".join(found.notes)
    found = imported(ImportOptions(units={"force": "N"}), **press)
    np.testing.assert_allclose(found.channels[0].effort, FORCE)
    assert f"column '{column}' is read as force in N, whatever its name says" in " ".join(found.notes)


def test_units_of_one_letter_belong_to_their_quantity():
    (press,) = imported(**{"Time [d]": T / 86400.0, "Travel [m]": X, "Load [t]": FORCE}).channels
    np.testing.assert_allclose(press.effort, 1e3 * G * FORCE)
    np.testing.assert_allclose(press.time_s, T, atol=1e-9)
    for name in ("q_d", "force_t", "pos_dm", "cell_day"):
        assert not dimension_of(split_unit(name)[1])


def test_prefix_in_a_header_of_capitals_is_noted():
    found = imported(**{"TIME [S]": T, "ANGLE [DEG]": X, "TORQUE [MNM]": FORCE})
    assert found.notes[0].endswith("read in MNm; if that is wrong, add --unit torque=mNm")


def test_counts_beside_a_force_are_lengths():
    press = {"Time [s]": T, "Encoder [counts]": np.round(2e6 * X), "Load [N]": FORCE}
    with pytest.raises(InputError, match=r"--unit position=0\.001mm, the value of one count"):
        imported(**press)
    for quantity in ("position", "displacement"):
        (channel,) = imported(ImportOptions(units={quantity: "0.0005mm"}), **press).channels
        np.testing.assert_allclose(channel.position, X, atol=1e-6)
    with pytest.raises(InputError, match="lever arm"):
        imported(ImportOptions(units={"position": "0.00153rad"}), **press)


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("Load [kPa]", 1e3, "used as the force, so results are in Pa, not N; for N, give the area, as"),
        ("Load [mV]", 1e-3, "used as the force, so results are in V, not N; for N, give the sensor's"),
    ],
)
def test_effort_without_a_constant_is_used_with_a_note(column, factor, words):
    found = imported(**{"t [s]": T, "Travel [m]": X, column: FORCE})
    np.testing.assert_allclose(found.channels[0].effort, factor * FORCE)
    assert words in " ".join(found.notes)
    beside = imported(**{"t [s]": T, "Travel [m]": X, column: T, "Load [N]": FORCE})
    np.testing.assert_allclose(beside.channels[0].effort, FORCE)


@pytest.mark.parametrize(
    ("strain", "stress", "length_m", "force_n"),
    [
        ("strain [mm/mm]", "stress [Pa]", 1.0, 1.0),
        ("Engineering Strain (%)", "Engineering Stress (kPa)", 0.01, 1e3),
        ("True strain", "True stress (MPa)", 1.0, 1e6),
    ],
)
def test_strain_and_stress_are_used_if_there_is_no_displacement_and_force(strain, stress, length_m, force_n):
    tension = {strain: X, stress: FORCE}
    (pull,) = imported(**tension).channels
    np.testing.assert_allclose(pull.position, X * length_m)
    np.testing.assert_allclose(pull.effort, FORCE * force_n)
    specimen = ImportOptions(units={"displacement": "0.05m/strain", "force": "1e-4N/Pa"})
    (pull,) = imported(specimen, **tension).channels
    np.testing.assert_allclose(pull.position, X * length_m * 0.05)
    np.testing.assert_allclose(pull.effort, FORCE * force_n * 1e-4)
    (pull,) = imported(**tension, extension_m=0.5 * X, load_N=2.0 * FORCE).channels
    np.testing.assert_allclose(pull.position, 0.5 * X)
    np.testing.assert_allclose(pull.effort, 2.0 * FORCE)


def test_missing_or_unknown_unit_is_asked_for():
    with pytest.raises(InputError, match="'stress' states no unit; give it, as in --unit force=MPa"):
        imported(strain=X, stress=FORCE)
    with pytest.raises(InputError, match=r"'cycles' is not a known unit of time; give it as a multiple"):
        imported(**{"Time (cycles)": T, "Travel (mm)": 1e3 * X, "Load (N)": FORCE})
    with pytest.raises(InputError, match=r"\('MM' is not a known unit\); give it, as in --unit displacement"):
        imported(**{"Time (s)": T, "Travel (MM)": 1e3 * X, "Load (N)": FORCE})
    with pytest.raises(InputError, match=r"--unit position=m$"):
        imported(time_s=T, position=X, force_N=FORCE)
    with pytest.raises(InputError, match=r"--unit position=mm$"):
        imported(time_s=T, position=1e3 * X, force_N=FORCE)
    with pytest.raises(InputError, match=r"--unit position=rad$"):
        imported(time_s=T, position=X, torque_Nm=FORCE)
    guess = guess_column("Iq")
    assert (guess.quantity, guess.unit) == ("torque", "")


@pytest.mark.parametrize(
    ("unit", "name"),
    [
        *(("MPa", "megapascals"), ("mA", "milliamps"), ("lbfft", "ft-lbf"), ("kgfcm", "kg.cm")),
        *(("rad_s", "rad.s"), ("kNm", "kN.m"), ("Nmm", "N.mm"), ("m_s", "m.s")),
    ],
)
def test_unit_names_take_any_prefix_and_products_any_sign(unit, name):
    assert normalize_unit(name) == unit
