"""Joints that a file counts from 0, in the names of its columns and in options."""

import numpy as np
import pytest

from palpate.estimation.base_model import Arm
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import read_table
from palpate.estimation.study.source import open_source
from palpate.robot_io.errors import InputError
from palpate.workbench.file_drop import _options_of, _suggest_columns
from tests.files import write_csv

T = np.arange(200) * 0.01
SIGNALS = np.sin(np.outer(T, [5.0, 3.0, 2.0, 7.0, 4.0]))
FROM_0 = ("position_0_rad", "position_1_rad", "torque_0_Nm", "torque_1_Nm")


@pytest.fixture
def log(tmp_path):
    """Writes a file of a time and of signals of these names."""
    return lambda *names: write_csv(
        tmp_path / "log.csv", {"time_s": T} | dict(zip(names, SIGNALS.T, strict=False))
    )


def pairs(path, **options):
    """Position's and effort's signal of each channel, and the factor of the effort."""
    found = []
    for channel in import_file(path, ImportOptions(**options)).channels:
        position, effort = (
            int(np.argmax(np.abs([np.corrcoef(signal, one)[0, 1] for one in SIGNALS.T])))
            for signal in (channel.position, channel.effort)
        )
        factor = np.ptp(channel.effort) / np.ptp(SIGNALS[:, effort])
        found.append((position, effort, pytest.approx(factor, rel=1e-6)))
    return found


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        (FROM_0, [(0, 2, 1.0), (1, 3, 1.0)]),
        (("position_0_rad", "position_1_rad", "motor current 1 [A]"), [(1, 2, 1.0)]),
        (("position_0_rad", "position_1_rad", "tau0 [Nm]", "tau1 [Nm]"), [(0, 2, 1.0), (1, 3, 1.0)]),
        (
            ("position_1_rad", "position_2_rad", "tau1 [Nm]", "tau2 [Nm]", "v0 [rad/s]"),
            [(0, 2, 1.0), (1, 3, 1.0)],
        ),
    ],
)
def test_position_is_paired_with_the_effort_of_its_number(log, names, joints):
    assert pairs(log(*names)) == joints


@pytest.mark.parametrize(
    "names",
    [
        ("position_0_rad", "position_1_rad", "torque_1_Nm", "torque_2_Nm"),
        ("q0 [rad]", "q1 [rad]", "torque_1_Nm", "torque_2_Nm"),
    ],
)
def test_joints_with_different_first_numbers_are_asked_about(log, names):
    path = log(*names)
    with pytest.raises(
        InputError, match="joint numbers start at 0 for position, but at 1 for torque; give"
    ) as error:
        pairs(path)
    assert "--column torque_0=torque_1_Nm --column torque_1=torque_2_Nm" in str(error.value)
    remedy = {"torque_0": "torque_1_Nm", "torque_1": "torque_2_Nm"}
    assert pairs(path, columns=remedy) == [(0, 2, 1.0), (1, 3, 1.0)]
    assert pairs(path, columns={"torque_1": "torque_1_Nm"}) == [(1, 2, 1.0)]


@pytest.mark.parametrize(
    ("unit", "factors"),
    [
        ("torque_1_Nm", (1.0, 10.0)),
        ("torque_1", (1.0, 10.0)),
        ("torque_0", (10.0, 1.0)),
        ("torque", (10.0, 10.0)),
    ],
)
@pytest.mark.parametrize("names", [FROM_0, ("q0 [rad]", "q1 [rad]", "torque_0_Nm", "torque_1_Nm")])
def test_unit_applies_to_the_joint_named_in_the_file(log, names, unit, factors):
    expected = [(0, 2, factors[0]), (1, 3, factors[1])]
    assert pairs(log(*names), units={unit: "10Nm"}) == expected


@pytest.mark.parametrize("place", [2, 3])
def test_column_applies_to_the_joint_named_in_the_file(log, place):
    names = [*FROM_0]
    names[place] = "strange"
    assert pairs(log(*names), columns={FROM_0[place]: "strange"}) == [(0, 2, 1.0), (1, 3, 1.0)]


def test_ambiguous_column_is_asked_by_number_and_the_page_takes_every_joint(log):
    path = log("q0 [rad]", "q1 [rad]", "tau0 [Nm]", "tau1 [Nm]", "torque 1 [Nm]")
    with pytest.raises(InputError, match="may hold torque_1; choose with --column torque_1='tau1"):
        pairs(path)
    choice = {"torque_1": "torque 1 [Nm]"}
    assert pairs(path, columns=choice) == [(0, 2, 1.0), (1, 4, 1.0)]
    assert import_file(path, ImportOptions(columns=choice)).notes == ()  # tau1 is no candidate for joint 0
    path = log(*FROM_0)
    options = _options_of(_suggest_columns(read_table(path)))
    assert options.columns["position_0"] == "position_0_rad"
    assert pairs(path, columns=options.columns, units=options.units) == [(0, 2, 1.0), (1, 3, 1.0)]


@pytest.mark.parametrize("form", ["{}_{}_{}", "{}_{} [{}]"])
def test_joints_that_share_a_number_are_paired_by_their_whole_prefix(log, form):
    units = {"pos": "rad", "tau": "Nm"}
    names = [form.format(leg, what, units[what]) for what in units for leg in ("FL0", "FR0")]
    path = log(*names)
    assert pairs(path) == [(0, 2, 1.0), (1, 3, 1.0)]
    assert import_file(path).columns["joint_2"] == (names[1], names[3])
    assert pairs(log(names[1], names[0], *names[2:])) == [(0, 3, 1.0), (1, 2, 1.0)]


def test_sides_of_a_gear_that_share_a_number_are_asked_about(log):
    sides = [f"{side}1_{what}" for what in ("pos_rad", "tau_Nm") for side in ("motor", "link")]
    with pytest.raises(InputError, match="'motor1_pos_rad' and 'link1_pos_rad' may hold position_1"):
        pairs(log(*sides))


UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint")


@pytest.mark.parametrize("order", [UR, sorted(UR)], ids=["of the arm", "alphabetical"])
def test_joints_named_in_the_urdf_have_its_order(order):
    """Joint states are often published in the alphabetical order of the joints."""
    places = {name: place for place, name in enumerate(UR)}
    columns = {"time_s": T} | {
        f"/joint_states/{name}/{what}": SIGNALS[:, places[name]] * factor
        for what, factor in (("position", 1.0), ("effort", 2.0))
        for name in order
    }
    channels = open_source(columns, arm=Arm(joint_names=UR)).channels
    assert [channel.name for channel in channels] == ["joint_1", "joint_2", "joint_3", "joint_4"]
    for signal, channel in zip(SIGNALS.T, channels, strict=False):
        np.testing.assert_allclose((channel.position, channel.effort), (signal, 2.0 * signal))


def test_joint_names_count_only_if_all_occur():
    columns = {"time_s": T}
    for number, name in enumerate(("elbow", "lift")):
        columns |= {f"/{name}/position [rad]": SIGNALS[:, number], f"/{name}/torque [Nm]": SIGNALS[:, number]}
    (first, _) = open_source(columns, arm=Arm(joint_names=("pan", "lift", "elbow"))).channels
    np.testing.assert_allclose(first.position, SIGNALS[:, 0])
    (first, _) = open_source(columns, arm=Arm(joint_names=("lift", "elbow"))).channels
    np.testing.assert_allclose(first.position, SIGNALS[:, 1])
