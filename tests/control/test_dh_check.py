"""A DH table that describes another arm than the URDF is refused; those of the tree's robot files are not."""

import re
import shutil
from pathlib import Path

import pytest

from control.arm.dh import check_dh_table
from control.arm.rigid_body import RigidBody
from robot_io.errors import InputError
from robot_io.robot_file import load_robot_file

ROOT = Path(__file__).resolve().parents[2]
ARMS = ROOT / "sim_backend" / "arms"
ROBOT_FILES = sorted(
    [*ARMS.glob("*/follower.yaml"), *ARMS.glob("*/leader.yaml"), *ROOT.glob("robots/*3dof.yaml")]
)


def check(robot):
    robot_file = load_robot_file(robot)
    check_dh_table(robot_file, RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame))


@pytest.fixture
def follower(tmp_path):
    """A copy of the follower, whose DH table may be changed."""
    return Path(shutil.copytree(ARMS / "follower", tmp_path / "follower"))


@pytest.mark.parametrize("robot", ROBOT_FILES, ids=lambda path: path.stem)
def test_the_tables_in_the_tree_are_those_of_their_arms(robot):
    assert len(ROBOT_FILES) >= 4
    check(robot)


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("a_m: 0.25", "a_m: 0.26", "10 mm from where the URDF puts 'tip'"),
        (r"fixed, alpha_rad: -1\.57\d*", "fixed, alpha_rad: -1.5", "turned against"),
        (r"name: wrist, type: revolute", "name: wrist, type: fixed", "has 2 joints, the URDF has 3"),
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


def test_a_robot_file_needs_no_table(follower):
    robot = follower / "follower.yaml"
    robot.write_text(re.sub("^dh:.*$", "", robot.read_text(), flags=re.MULTILINE))
    (follower / "follower.dh.yaml").unlink()
    check(robot)
