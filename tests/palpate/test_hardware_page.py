"""docs/reference/robot-file.md shows the shipped robot file as it is."""

import re

from robot_io.files.file_model import load_yaml, parse_yaml
from tests.palpate.cli import ROOT

PAGE = ROOT / "docs" / "reference" / "robot-file.md"
ROBOT = ROOT / "robots" / "dynamixel_3dof.yaml"
PLAIN = """name urdf buses motors load_cell driver port id bus limits safe_state encoder torque force home_rad
    position_min_rad position_max_rad"""


def test_the_robot_file_is_shown_as_it_is_shipped():
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert parse_yaml("".join(blocks), str(PAGE)).data == load_yaml(ROBOT).data


def test_every_key_that_says_little_by_itself_is_explained():
    prose = re.sub(r"```yaml\n.*?```", "", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    keys = set(re.findall(r"(\w+):", re.sub(r"#.*", "", ROBOT.read_text(encoding="utf-8"))))
    plain = set(PLAIN.split())
    ages = {key for key in keys if key.endswith("_age_s")}
    assert "`_age_s`" in prose
    assert not [key for key in sorted(keys - plain - ages) if f"`{key}" not in prose]
