"""Measured data that are no part of the project; the docs state their sources."""

import os
from pathlib import Path

import numpy as np
import pytest

from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.fit.samples import fit_samples
from tests.estimation.contact_data import base_model, estimated

DATA = Path(os.environ.get("PALPATE_DATA") or Path(__file__).resolve().parents[2].parent / "shared" / "data")
pytestmark = pytest.mark.skipif(
    not (DATA / "soft_indentation").is_dir(),
    reason=f"the measured data are not at {DATA} (set PALPATE_DATA to where they are)",
)
FIRST_P002 = "230515-P002-10"
FOLLOWING_CHANGES = {"cusum_rls", "preemptive_ransac"}


def indentation(specimen):
    return import_file(DATA / "soft_indentation" / "runs.csv.gz", ImportOptions(where={"specimen": specimen}))


def test_stiffness_of_a_soft_specimen_matches_its_curve():
    (channel,) = indentation(FIRST_P002).channels
    assert channel.runs.tolist() == [19]
    stiffness = estimated(channel)["stiffness.k"]
    assert stiffness.value == pytest.approx(97.0, rel=0.03)
    assert stiffness.interval[0] < 97.0 < stiffness.interval[1]
    assert stiffness.unit == "N/m"


@pytest.mark.parametrize("name", sorted(set(ESTIMATORS) - {"ransac"} - FOLLOWING_CHANGES))
def test_batch_estimators_agree(name):
    """RANSAC's threshold of 0.01 N is far below what the model leaves here; the others must stay near."""
    (channel,) = indentation(FIRST_P002).channels
    assert estimated(channel, by=name)["stiffness.k"].value == pytest.approx(97.0, rel=0.12)


@pytest.mark.parametrize("name", sorted(FOLLOWING_CHANGES))
def test_online_estimators_match_the_stiffness_of_the_last_hold(name):
    """The specimen stiffens and relaxes: force over depth is 48 N/m in the last hold, at 1 mm, not 97."""
    (channel,) = indentation(FIRST_P002).channels
    found = estimated(channel, by=name)
    last_hold = slice(-100, None)
    secant = np.median(channel.effort[last_hold] / channel.position[last_hold])
    assert found["stiffness.k"].value == pytest.approx(secant, rel=0.05)


def test_hunt_crossley_fits_all_specimens_better():
    (channel,) = indentation(FIRST_P002).channels
    curved = fit_samples(base_model("hunt_crossley"), channel, channel.engaged)
    straight = fit_samples(base_model("kelvin_voigt"), channel, channel.engaged)
    assert 1.2 < curved.parameters["hunt_crossley.n"] < 1.5
    assert np.std(curved.residuals) < 0.75 * np.std(straight.residuals)
    (channel,) = import_file(DATA / "soft_indentation" / "runs.csv.gz").channels
    assert len(channel) == 15507
    assert len(channel.runs) == 23


@pytest.mark.parametrize(
    ("file", "options", "kind", "rows"),
    [
        ("emps/train.csv.gz", {"columns": {"force_N": "motor_force_N"}}, "prismatic", 24841),
        (
            "silverbox/silverbox.csv.gz",
            {"columns": {"position_m": "output_voltage_V", "force_N": "input_voltage_V"}},
            "prismatic",
            131072,
        ),
        ("xl330_pendulum/runs.csv.gz", {"columns": {"torque_Nm": "load_register"}}, "revolute", 19452),
        (
            "servo_backlash/telemetry.csv.gz",
            {"columns": {"torque_Nm": "load_register", "run": "log"}, "where": {"motor_id": "1"}},
            "revolute",
            1392,
        ),
        (
            "load_cell/load_cell.csv",
            {"columns": {"displacement_m": "nominal_force_N", "force_N": "load_cell_1_counts"}},
            "contact",
            1324,
        ),
    ],
)
def test_public_files_are_read(file, options, kind, rows):
    (channel,) = import_file(DATA / file, ImportOptions(**options)).channels
    assert (channel.kind, len(channel)) == (kind, rows)
    assert np.isfinite(channel.acceleration).all()


def test_mass_of_a_linear_drive_is_identified():
    """EMPS: Janot, Gautier, Brunot (2019) give 95.1 kg."""
    options = ImportOptions(columns={"force_N": "motor_force_N"})
    (channel,) = import_file(DATA / "emps" / "train.csv.gz", options).channels
    columns = np.column_stack(
        [channel.acceleration, channel.velocity, np.ones(len(channel)), np.sign(channel.velocity)]
    )
    gains = np.linalg.lstsq(columns, channel.effort, rcond=None)[0]
    assert gains[0] == pytest.approx(95.1, rel=0.01)
    assert gains[3] == pytest.approx(20.4, rel=0.05)
