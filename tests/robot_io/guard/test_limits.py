"""The times of the plausibility checks are in the robot file, and documented as they are."""

import re
from pathlib import Path

import pytest

from robot_io.guard import Limits

PAGE = Path(__file__).resolve().parents[3] / "docs" / "hardware.md"
WITNESSES = ("deaf_drive_s", "stuck_encoder_s", "stuck_force_s")


@pytest.mark.parametrize("key", WITNESSES)
def test_a_limit_that_may_be_left_out_is_documented_with_its_value(key):
    (value,) = re.findall(rf"^\| `{key}` \| ([\d.]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert Limits.model_fields[key].default == float(value)
