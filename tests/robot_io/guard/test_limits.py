"""Limits: plausible values, and documented defaults."""

import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from palpate.robot_io.guard import Limits, SafeState

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "robot-file.md"
FAULT_TIMES = ("unresponsive_drive_s", "stuck_encoder_s", "stuck_force_s")


@pytest.mark.parametrize("key", FAULT_TIMES)
def test_optional_limit_is_documented_with_its_default(key):
    (value,) = re.findall(rf"^\| `{key}` \| ([\d.]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert Limits.model_fields[key].default == float(value)


EDGES = [  # a value that is still a limit, and beyond which there would be none
    *(("torque_nm", 1e4), ("torque_rate_nm_s", 1e7), ("position_min_rad", -100.0)),
    *(("position_max_rad", 100.0), ("velocity_rad_s", 100.0), ("force_n", 5000.0), ("tracking_rad", 2.0)),
    *(("encoder_age_s", 10.0), ("torque_age_s", 10.0), ("force_age_s", 10.0), ("unresponsive_drive_s", 10.0)),
    *(("stop_time_s", 10.0), ("lower_time_s", 10.0), ("lower_speed_rad_s", 2.0)),
]
LIMITS = {key: 0.1 if key.endswith("_s") else (1.0,) for key in Limits.model_fields}
LIMITS |= {"position_min_rad": (-1.0,), "force_n": 1.0, "velocity_rad_s": (1.0,), "torque_rate_nm_s": (1.0,)}
SAFE_STATE = {"damping_nms_rad": (1.0,), "stop_time_s": 1.0}


@pytest.mark.parametrize(("key", "edge"), EDGES)
def test_limit_beyond_any_arm_is_refused(key, edge):
    model, values = (Limits, LIMITS) if key in LIMITS else (SafeState, SAFE_STATE)
    as_there = (lambda value: (value,)) if isinstance(values.get(key), tuple) else float
    assert getattr(model(**values | {key: as_there(edge)}), key) == as_there(edge)
    with pytest.raises(ValidationError):
        model(**values | {key: as_there(1.001 * edge)})


@pytest.mark.parametrize(("model", "key"), [(Limits, "torque_nm"), (SafeState, "damping_nms_rad")])
def test_arm_needs_a_joint(model, key):
    with pytest.raises(ValidationError, match="at least 1 item"):
        model(**(LIMITS if model is Limits else SAFE_STATE) | {key: ()})


def test_lowering_is_as_documented_and_joints_need_room_and_values():
    with pytest.raises(ValidationError, match=r"1.0 is not below position_max_rad 1.0 of joint 1"):
        Limits(**LIMITS | {"position_min_rad": (1.0,)})
    with pytest.raises(
        ValidationError, match="tracking_rad has 2 values, but torque_nm has 1; give one per joint"
    ):
        Limits(**LIMITS | {"tracking_rad": (1.0, 1.0)})
    (lower_time_s,) = re.findall(r"`lower_time_s` \((\d+) s by default\)", PAGE.read_text(encoding="utf-8"))
    safe_state = SafeState(**SAFE_STATE)
    assert safe_state.lower_time_s == float(lower_time_s)
    assert safe_state.lower_time_s * safe_state.lower_speed_rad_s < 1.0  # it is let down, not far


def test_former_key_of_a_limit_is_accepted():
    values = {key: value for key, value in LIMITS.items() if key != "unresponsive_drive_s"}
    assert Limits(**values, deaf_drive_s=0.3).unresponsive_drive_s == 0.3
    assert Limits(**LIMITS, deaf_drive_s=0.3).unresponsive_drive_s == 0.1
