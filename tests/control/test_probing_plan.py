"""Probing plans: order of the runs, and what is refused."""

import pytest

from control.probing.plan import ProbingPlan, load_probing_plan
from robot_io.errors import InputError

TARGETS = ((0.4, 0.0, 0.05), (0.42, 0.0, 0.05))


def test_every_target_gets_every_repeat_of_every_speed():
    plan = ProbingPlan(speeds_m_s=(0.1, 0.05), repeats=2, targets_world_m=TARGETS)
    runs = list(plan.runs())
    assert [run.run for run in runs] == list(range(8))
    assert [run.target for run in runs] == [0] * 4 + [1] * 4
    assert [run.repeat for run in runs] == [0, 0, 1, 1] * 2
    assert [run.speed_m_s for run in runs] == [0.1, 0.05] * 4


def test_without_targets_there_is_one():
    assert [run.target for run in ProbingPlan().runs()] == [0, 0, 0]


def test_the_direction_becomes_a_unit_vector():
    assert ProbingPlan(press_direction_world=(0, 0, -3)).press_direction_world == (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speeds_m_s: []", "plan.yaml line 1, speeds_m_s"),
        ("speeds_m_s: [0.1, -0.1]", "speeds_m_s entry 2: .*greater than 0"),
        ("speeds_m_s: [10]", "speeds_m_s entry 1: .*less than or equal to 1 "),
        ("force_limit: 5", "force_limit: .*did you mean 'force_limit_n'"),
        ("force_limit_n: 1e-300", "force_limit_n: .*greater than or equal to 0.01"),
        ("force_limit_n: true", "force_limit_n: expected a number"),
        ("press_direction_world: [0, 0, 0]", "has no direction"),
        ("excitation: {amplitude_n: 4.5}", r"at most 4 N for force_limit_n 10\.0 N"),
        ("{speeds_m_s: [0.5], acceleration_m_s2: 2}", r"approach_clearance_m 0\.03 m .*at least 0\.0938 m"),
        ("retract_m: 0.002", "retract_m 0.002 m is too short"),
        ("hold_s: soon", "hold_s: expected a number"),
    ],
)
def test_a_bad_plan_is_one_clear_line(text, message, tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(text + "\n")
    with pytest.raises(InputError, match=message) as caught:
        load_probing_plan(path)
    assert "\n" not in str(caught.value)


def test_a_plan_is_read_from_its_file(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("speeds_m_s: [0.05]\nexcitation: {shape: chirp}\n")
    plan = load_probing_plan(path)
    assert plan.speeds_m_s == (0.05,)
    assert plan.excitation.shape == "chirp"
    assert plan.force_limit_n == 10.0


def test_the_shortest_time_counts_every_run():
    plan = ProbingPlan(
        speeds_m_s=(0.1, 0.05),
        repeats=3,
        hold_s=2.0,
        settle_s=0.5,
        free_air_s=0.25,
        approach_clearance_m=0.05,
    )
    assert plan.shortest_s == pytest.approx(3 * (0.5 + 1.0 + 2 * 2.75))
    assert len(list(plan.runs())) == 6
