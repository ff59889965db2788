"""Gains come from the robot file, or are refused with its line."""

import pytest

from control.laws.gains import Gains, gains_of
from robot_io.errors import InputError
from robot_io.robot_file import parse_robot_file
from tests.mock_robot import ROBOT_YAML


def file_with(gains: str):
    return parse_robot_file(ROBOT_YAML + gains, "arm.yaml")


def test_a_file_without_gains_has_the_defaults():
    assert gains_of(file_with("")) == Gains()


def test_what_a_file_leaves_out_keeps_its_default():
    gains = gains_of(file_with("gains: {contact: {mass_kg: 2.5}}\n"))
    assert gains.contact.mass_kg == 2.5
    assert gains.contact.latency_s == Gains().contact.latency_s
    assert gains.tracking == Gains().tracking


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{contact: {mas_kg: 2}}", r"arm.yaml line \d+, gains.contact.mas_kg: .*did you mean 'mass_kg'"),
        ("{contact: {mass_kg: -2}}", r"gains.contact.mass_kg: .*greater than 0 \(is -2\)"),
        ("{tracking: {bandwidth_rad_s: 20, integral_rate_1_s: 15}}", r"gains.tracking: .*too fast"),
        ("{touch: {debounce_samples: 0}}", "gains.touch.debounce_samples"),
        ("{contact: {loading_aim: 0.5}}", "gains.contact.loading_aim"),
    ],
)
def test_a_bad_gain_names_file_line_and_key(text, message):
    with pytest.raises(InputError, match=message):
        gains_of(file_with(f"gains: {text}\n"))


def test_the_shipped_arms_have_valid_gains():
    from pathlib import Path

    from robot_io.robot_file import load_robot_file

    arms = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
    for name in ("leader", "follower"):
        gains_of(load_robot_file(arms / name / f"{name}.yaml"))
