"""DH tables against Pinocchio on the URDFs that they describe."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from palpate.control.arm.dh import DhRow, DhTable, check_dh_table
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import parse_yaml
from palpate.robot_io.robot_file import load_robot_file

ROOT = Path(__file__).resolve().parents[2]
ARMS = ROOT / "sim_backend" / "arms"
ROBOT_FILES = sorted(
    [*ARMS.glob("*/follower.yaml"), *ARMS.glob("*/leader.yaml"), *ROOT.glob("robots/*3dof.yaml")]
)


def test_one_revolute_row_by_hand():
    row = DhRow(name="j", type="revolute", theta_rad=np.pi / 2, d_m=0.1, a_m=0.3, alpha_rad=np.pi / 2)
    frame = row.transform(0.0).homogeneous
    assert frame[:3, 3] == pytest.approx((0.0, 0.3, 0.1), abs=1e-12)  # x has turned onto y
    assert frame[:3, 2] == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)  # and z onto the old x


def test_one_prismatic_row_by_hand():
    row = DhRow(name="j", type="prismatic", theta_rad=np.pi / 2, d_m=0.1, a_m=0.3, alpha_rad=np.pi / 2)
    expected = [[0, 0, 1, 0], [1, 0, 0, 0.3], [0, 1, 0, 0.35], [0, 0, 0, 1]]  # 0.25 m further along z
    assert DhTable(name="a", rows=(row,)).tip_frame(np.array([0.25])) == pytest.approx(
        np.array(expected), abs=1e-12
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nrows:\n  - {name: j, type: revolut}\n", r"line 3, rows entry 1.type: .*'revolute'"),
        ("name: a\nrows:\n  - {name: j, type: revolute, a_m: .nan}\n", r"rows entry 1.a_m: .*finite"),
        ("name: a\nrows:\n  - {name: j, type: fixed}\n", "no row is a joint"),
        ("name: a\nrows: [{name: j, type: revolute}, {name: j, type: fixed}]\n", "same name"),
    ],
)
def test_invalid_table_is_one_clear_line(text, message):
    with pytest.raises(InputError, match=message) as caught:
        DhTable.load(parse_yaml(text, "arm.yaml"))
    assert "\n" not in str(caught.value)


def test_number_of_positions_must_fit():
    with pytest.raises(InputError, match="joint positions"):
        DhTable(name="a", rows=(DhRow(name="j", type="revolute"),)).tip_frame(np.zeros(2))


def check(robot):
    robot_file = load_robot_file(robot)
    check_dh_table(robot_file, RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame))


@pytest.fixture
def follower(tmp_path):
    """A copy of the follower, whose DH table may be changed."""
    return Path(shutil.copytree(ARMS / "follower", tmp_path / "follower"))


@pytest.mark.parametrize("robot", ROBOT_FILES, ids=lambda path: path.stem)
def test_documented_tables_are_those_of_their_arms(robot):
    assert len(ROBOT_FILES) >= 4
    check(robot)


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("a_m: 0.25", "a_m: 0.26", "10 mm from the URDF's 'tip'"),
        (r"fixed, alpha_rad: -1\.57\d*", "fixed, alpha_rad: -1.5", "at an angle to"),
        (r"name: wrist, type: revolute", "name: wrist, type: fixed", "has 2 joints, but the URDF has 3"),
        ("a_m: 0.25", "a_mm: 250", "is not known"),
    ],
)
def test_another_arm_s_table_is_refused(follower, wrong, right, words):
    table = follower / "follower.dh.yaml"
    changed = re.sub(wrong, right, table.read_text())
    assert changed != table.read_text()
    table.write_text(changed)
    with pytest.raises(InputError, match=r"follower\.dh\.yaml") as caught:
        check(follower / "follower.yaml")
    assert words in str(caught.value)


def test_robot_file_needs_no_table(follower):
    robot = follower / "follower.yaml"
    robot.write_text(re.sub("^dh:.*$", "", robot.read_text(), flags=re.MULTILINE))
    (follower / "follower.dh.yaml").unlink()
    check(robot)
