"""A plan that the guard would trip on is refused before anything moves."""

import numpy as np
import pytest

from control.laws.gains import Gains
from control.loop.result import Outcome
from control.paths.excitation import Excitation
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from robot_io.errors import InputError
from robot_io.robot_file import load_robot_file
from tests.control.probing_runs import WIDE, plant_above
from tests.control.reference_plant import TOOL_AXIS_TIP, test_arm
from tests.control.simulated_arms import ARMS, SimulatedArm, kelvin_voigt

FOLLOWER = load_robot_file(ARMS / "follower" / "follower.yaml")  # trips at 60 N and 6 rad/s


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (
            {"force_limit_n": 100.0},
            r"force_limit_n 100 N: the guard of 'follower' trips at 60 N .*at most 54.5 N",
        ),
        ({"force_limit_n": 58.0}, "at most 54.5 N"),  # it would trip on the first overshoot
        ({"joint_speed_rad_s": 7.0}, r"joint_speed_rad_s 7: .* trips at 6 rad/s .*at most 5.45 rad/s"),
    ],
)
def test_what_the_guard_would_trip_on_is_refused_in_one_line(plan, message):
    with pytest.raises(InputError, match=message) as refused:
        ProbingTask.from_robot_file(FOLLOWER, ProbingPlan(**plan))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "plan",
    [
        {"force_limit_n": 54.0, "joint_speed_rad_s": 5.4},
        {"force_limit_n": 54.0, "excitation": Excitation(quantity="force", amplitude_n=10.0)},
        {"force_limit_n": 54.0, "excitation": Excitation(quantity="position", amplitude_n=10.0)},
    ],
)
def test_what_it_would_not_is_not(plan):
    ProbingTask.from_robot_file(FOLLOWER, ProbingPlan(**plan))


def test_an_excitation_of_the_force_never_goes_beyond_the_limit_that_it_rides_on():
    ride = Excitation(quantity="force", amplitude_n=15.0, duration_s=2.0, high_hz=4.0)
    plan = ProbingPlan(speeds_m_s=(0.05,), force_limit_n=54.0, hold_s=0.2, excitation=ride)
    arm = SimulatedArm("follower", plan, kelvin_voigt(5000.0))
    result = arm.run()
    assert result.outcome is Outcome.FINISHED, result.cause
    excited_s = next(time_s for time_s, kind, _ in arm.log.events if kind == "excitation")
    excited = (arm.truth[:, 0] > excited_s + 0.1) & (arm.truth[:, 0] < excited_s + 2.0)
    forces = arm.truth[excited, 2]
    assert forces.min() < 30.0
    assert forces.max() < 54.5


@pytest.mark.parametrize(
    ("plan", "name"),
    [({"speeds_m_s": (0.1, 0.3)}, "speeds_m_s 0.3"), ({"travel_speed_m_s": 0.4}, "travel_speed")],
)
def test_speeds_that_a_joint_cannot_follow_are_refused_at_the_start(plan, name):
    def start(fastest_rad_s):
        fastest = np.full(3, fastest_rad_s)
        task = ProbingTask(
            test_arm(),
            TOOL_AXIS_TIP,
            Gains(),
            ProbingPlan(**plan),
            position_limits_rad=WIDE,
            velocity_limits_rad_s=fastest,
        )
        task.start(plant_above().measure())

    start(4.0)
    with pytest.raises(
        InputError, match=rf"{name}.* at target 1 joint \d would move at .* trips at 0.5 rad/s"
    ):
        start(0.5)
