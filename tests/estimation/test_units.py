"""Units in names: prefixes, products, and substitutes for an effort."""

import numpy as np
import pytest

from palpate.estimation.data.column_names import guess_column, split_unit
from palpate.estimation.data.file_columns import FileColumns
from palpate.estimation.data.import_file import import_table
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import table_of
from palpate.estimation.data.units import SI, dimension_of, normalize_unit
from palpate.robot_io.errors import InputError

pa = pytest.importorskip("pyarrow")
T = np.arange(400) * 0.01
X = 0.004 * (1.0 - np.cos(3.0 * T))
FORCE = 500.0 * X
G = 9.80665


@pytest.mark.parametrize("form", ["Load ({})", "Load [{}]", "Load / {}", "load_{}", "Load {}", "Load in {}"])
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
        ("Time [min]", "time", 60.0),
        ("TIME (MIN)", "time", 60.0),
        ("t_us", "time", 1e-6),
        ("t [ns]", "time", 1e-9),
        ("height (nm)", "length", 1e-9),
        ("z (µm)", "length", 1e-6),
        ("Torque NM", "torque", 1.0),
        ("Torque N m", "torque", 1.0),
        ("Torque (kgf cm)", "torque", 0.01 * G),
        ("Torque kgf cm", "torque", 0.01 * G),
        ("Torque [oz in]", "torque", 0.45359237 * G / 16.0 * 0.0254),
        ("Torque [oz-in]", "torque", 0.45359237 * G / 16.0 * 0.0254),
        ("p (psi)", "pressure", 0.45359237 * G / 0.0254**2),
        ("p (bar)", "pressure", 1e5),
        ("bridge [mV]", "voltage", 1e-3),
        ("Speed mm/s", "length_rate", 1e-3),
        ("speed [rpm]", "angle_rate", np.pi / 30.0),
    ],
)
def test_machine_units_are_known(name, dimension, factor):
    assert factor_of(name) == (dimension, pytest.approx(factor, rel=1e-12))


@pytest.mark.parametrize("unit", ["MM", "MS", "MV", "xN", "furlong"])
def test_words_are_not_read_as_units(unit):
    assert dimension_of(normalize_unit(unit)) is None


def factor_of(name):
    unit = split_unit(name)[1]
    return dimension_of(unit), SI[dimension_of(unit)][unit]


def imported(options=None, **columns):
    return import_table(table_of(FileColumns(pa.table(columns)), "press"), options or ImportOptions())


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
    ("column", "factor", "words"),
    [
        ("Load [kPa]", 1e3, "is a pressure used as the force: 1 Pa counts as 1 N; give the area, as"),
        ("Load [mV]", 1e-3, "is a voltage used as the force: 1 V counts as 1 N; give the sensor's"),
    ],
)
def test_effort_without_a_constant_is_used_with_a_note(column, factor, words):
    found = imported(**{"t [s]": T, "Travel [m]": X, column: FORCE})
    np.testing.assert_allclose(found.channels[0].effort, factor * FORCE)
    assert words in found.notes[0]
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


def test_unit_of_a_stress_is_asked_for():
    with pytest.raises(InputError, match="'stress' states no unit; give it, as in --unit force=MPa"):
        imported(strain=X, stress=FORCE)


def test_missing_or_unknown_unit_is_asked_for():
    with pytest.raises(InputError, match=r"'cycles' is not a known unit of time; use --unit time=s"):
        imported(**{"Time (cycles)": T, "Travel (mm)": 1e3 * X, "Load (N)": FORCE})
    with pytest.raises(InputError, match=r"\('MM' is not\); give it, as in --unit displacement"):
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
    ("unit", "name"), [("MPa", "megapascals"), ("mA", "milliamps"), ("lbfft", "ft-lbf"), ("kgfcm", "kg.cm")]
)
def test_unit_names_take_any_prefix_and_products_any_sign(unit, name):
    assert normalize_unit(name) == unit
