"""Files that hold a part of a measurement, and names in which a word tells the quantity."""

import numpy as np
import pytest
from scipy.io import savemat

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.column_names import guess_columns
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_files import import_files
from palpate.estimation.data.import_options import ImportOptions
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import FORCE_N, TIME_S, WAY_M
from tests.files import saved


def lines(*columns):
    """Rows of numbers separated by commas."""
    return "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in zip(*columns, strict=True))


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        import_file(path, ImportOptions(**options))
    return str(caught.value)


def test_files_with_one_column_each_are_joined(tmp_path):
    way = saved(tmp_path / "deformation_data.txt", lines(1e3 * WAY_M))
    force = saved(tmp_path / "force_data.txt", lines(FORCE_N))
    message = refusal(way)
    assert "force_data.txt has the same number of rows" in message
    assert message.endswith(f"palpate import {way} {force}")
    units = {"displacement": "mm", "force": "N"}
    (channel,) = import_files([way, force], ImportOptions(units=units)).channels
    assert channel.kind is ChannelKind.CONTACT
    assert np.allclose(channel.effort, FORCE_N, atol=1e-6)


def test_one_column_without_a_completing_file_is_refused(tmp_path):
    alone = saved(tmp_path / "force.csv", lines(FORCE_N))
    saved(tmp_path / "deformation.csv", lines(WAY_M[1:]))
    assert "holds only one column" in refusal(alone)


def test_an_effort_in_another_matlab_file_is_named(tmp_path):
    savemat(tmp_path / "q.mat", {"q": np.sin(np.outer(TIME_S, [1.0, 2.0]))})
    savemat(tmp_path / "tau.mat", {"tau_raw": np.cos(np.outer(TIME_S, [1.0, 2.0]))})
    assert "tau.mat has the same number of rows" in refusal(tmp_path / "q.mat")


@pytest.mark.parametrize(
    ("names", "quantities"),
    [
        (["timeJIM", "angleJIM", "torque"], ["time", "position", "torque"]),
        (["t", "torAct", "posAct"], ["time", "torque", "position"]),
        (["time", "motorStatePos_0", "motorStateCur_0"], ["time", "position", "torque"]),
        (["time values", "angle values", "torque values"], ["time", "position", "torque"]),
        (["Neo_Avg_Strain_L", "Neo_Avg_Stress_L"], ["displacement", "force"]),
        (["PositionArrayb", "ForceArrayb"], ["position", "force"]),
        (["Trial_Elapsed_s", "Middle_Angle", "Middle_Force_N"], ["time", "position", "force"]),
    ],
)
def test_a_word_anywhere_tells_the_quantity_if_no_channel_is_found_otherwise(names, quantities):
    assert [guess.quantity for guess in guess_columns(names)] == quantities


def test_words_anywhere_do_not_add_columns_to_a_clear_measurement():
    names = ["time_s", "displacement_mm", "force_N", "torqueSensorRaw", "angleOfTable"]
    assert [guess.quantity for guess in guess_columns(names)][3:] == ["", ""]


def test_a_current_is_not_preferred_to_a_torque_without_units(tmp_path):
    q, tau = np.sin(TIME_S), np.cos(TIME_S)
    both = saved(tmp_path / "both.csv", "time,position,torque,current\n" + lines(TIME_S, q, tau, 3.0 * tau))
    assert "columns 'position', 'torque' state no units" in refusal(both)
    current = saved(tmp_path / "current.csv", "time,position,current\n" + lines(TIME_S, q, 3.0 * tau))
    assert "--unit position=rad --unit torque=A" in refusal(current)


def test_the_command_of_a_drive_is_suggested_as_the_effort(tmp_path):
    path = saved(tmp_path / "drive.csv", "t,rpm,duty\n" + lines(TIME_S, np.sin(TIME_S), np.cos(TIME_S)))
    assert "--column velocity=rpm --column torque=duty --unit torque=1Nm" in refusal(path)
    options = {"columns": {"velocity": "rpm", "torque": "duty"}, "units": {"torque": "1Nm"}}
    (channel,) = import_file(path, ImportOptions(**options)).channels
    assert channel.kind is ChannelKind.REVOLUTE


def test_a_second_clock_without_a_name_is_not_suggested_as_a_motion(tmp_path):
    day, since_1904 = 43884.7 + TIME_S / 86400.0, 3.79e9 + TIME_S
    columns = np.column_stack([day, since_1904, TIME_S, FORCE_N, 1e3 * WAY_M])
    np.savetxt(tmp_path / "clocks.csv", columns, fmt="%.12f", delimiter=",")
    message = refusal(tmp_path / "clocks.csv")
    assert "--column time='column 2' --column displacement='column 5'" in message
    assert "--column force='column 4'" in message


def test_a_position_and_a_load_without_units_may_be_a_joint(tmp_path):
    table = "time,position,load\n" + lines(TIME_S, np.sin(TIME_S), np.cos(TIME_S))
    message = refusal(saved(tmp_path / "servo.csv", table))
    assert "--column torque=load --unit position=rad --unit torque=Nm" in message


def test_each_quantity_is_given_one_unit(tmp_path):
    small, large = np.sin(TIME_S), 90.0 * np.sin(TIME_S)
    header = "time,q1,q2,tau1,tau2\n"
    message = refusal(saved(tmp_path / "joints.csv", header + lines(TIME_S, small, large, small, small)))
    assert message.endswith("--unit position=deg --unit torque=Nm")
