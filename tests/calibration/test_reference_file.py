import os
from pathlib import Path

import numpy as np
import pytest

from palpate.calibration.force import fit_force, read_reference_file
from palpate.robot_io.errors import InputError

DATA = Path(os.environ.get("PALPATE_DATA", Path(__file__).resolve().parents[2] / ".." / "shared" / "data"))
LOAD_CELL = DATA / "load_cell" / "load_cell.csv"
KG = [0, 1, 2, 3, 2, 1, 0]


def write(folder, header, rows):
    path = folder / "cell.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_masses_become_weights_and_names_give_units(tmp_path):
    rows = [f"{500 + 100 * kg + sample % 2},{kg}" for kg in KG for sample in range(20)]
    plateaus, unit = read_reference_file(write(tmp_path, "reading_counts,reference_kg", rows), {})
    assert unit == "count"
    np.testing.assert_allclose(plateaus.reference_n, 9.80665 * np.array(KG))
    assert fit_force(plateaus).scale.value == pytest.approx(0.0980665)


@pytest.mark.parametrize(
    ("name", "newton"), [("mass_kg", 9.80665), ("weight_lbf", 4.4482216), ("force_N", 1.0)]
)
def test_only_other_column_in_a_unit_of_load_is_the_reference(tmp_path, name, newton):
    rows = [f"{0.01 * n},{500 + 100 * load + n % 2},{load}" for load in KG for n in range(20)]
    plateaus, _ = read_reference_file(write(tmp_path, f"time_s,reading_counts,{name}", rows), {})
    np.testing.assert_allclose(plateaus.reference_n, newton * np.array(KG))


@pytest.mark.parametrize(
    ("header", "columns", "words"),
    [
        ("time_s,reading_N,reading_V", {}, ("the reading? Use --column reading=reading_N",)),
        ("reading_N,mass_kg,load_lbf", {}, ("the reference? Use --column reference=mass_kg",)),
        ("time_s,reading_N,reading_error_N", {"reading": "reading_N"}, ("which column is the reference",)),
        ("counts,reference_N", {}, ("--column reading=counts", "Available: counts, reference_N")),
        ("reading_counts,reference_apples", {}, ("reference_apples", "kg")),
        ("reading_pears,reference_N", {}, ("--reading-unit",)),
        ("reading_counts,reference_N", {"weight": "x"}, ("--column weight", "reading, reference, settled")),
    ],
)
def test_incomplete_file_is_refused(tmp_path, header, columns, words):
    with pytest.raises(InputError) as caught:
        read_reference_file(
            write(tmp_path, header, [f"{n}" + ",0" * header.count(",") for n in (1, 2, 3)]), columns
        )
    for word in words:
        assert word in str(caught.value)


@pytest.mark.skipif(not LOAD_CELL.is_file(), reason=f"measured data are not there: {LOAD_CELL}")
@pytest.mark.parametrize(("cell", "counts_n", "glitches"), [(1, 224.4, False), (2, 225.7, True)])
def test_measured_load_cells_have_only_a_zero_and_a_scale(cell, counts_n, glitches):
    """Cell 2's converter glitched; the counts per newton are those that the data's own README found."""
    columns = {"reading": f"load_cell_{cell}_counts", "reference": "nominal_force_N"}
    plateaus, unit = read_reference_file(LOAD_CELL, columns)
    fit = fit_force(plateaus)
    assert unit == "count"
    assert 1 / fit.scale.value == pytest.approx(counts_n, rel=2e-3)
    assert (plateaus.glitches > 0) is glitches
    assert fit.curvature is None
    assert abs(fit.hysteresis_n.value) < 4 * fit.hysteresis_n.std_err
    assert fit.rms_n < 0.35
