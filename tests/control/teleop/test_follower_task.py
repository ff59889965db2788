"""Follower queue and task on their own plant: only requested targets are probed."""

import numpy as np
import pytest

from palpate.control.laws.gains import Gains
from palpate.control.loop.task import Phase, TaskOutput
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.control.teleop.follower_task import FollowerTask, SilenceAction, TargetQueue
from palpate.robot_io.link.messages import Target, TargetState, short_number, target_number
from tests.control.probing_runs import TICK_S, WIDE, plant_above
from tests.control.reference_plant import TOOL_AXIS_TIP, ReferencePlant, test_arm
from tests.robot_io.link.link_parts import intent, target

PLAN = ProbingPlan(speeds_m_s=(0.1, 0.05), hold_s=0.1, settle_s=0.05, free_air_s=0.1)
NEAR = target(0, 0.42)


class FollowerRig:
    """A follower on the reference plant; `until` runs it."""

    def __init__(self, on_silence: SilenceAction = SilenceAction.FINISH) -> None:
        self.plant: ReferencePlant = plant_above()
        self.queue = TargetQueue()
        self.queue.linked = True
        body = test_arm()

        def probing(wanted: Target) -> ProbingTask:
            place = {"targets_world_m": (wanted.position_world_m,)}
            plan = PLAN.model_copy(update=place | {"press_direction_world": wanted.direction_world})
            return ProbingTask(body, TOOL_AXIS_TIP, Gains(), plan, position_limits_rad=WIDE)

        self.task = FollowerTask(body, TOOL_AXIS_TIP, Gains(), self.queue, probing, on_silence=on_silence)
        self.home_rad = self.plant.position_rad.copy()
        self.task.start(self.plant.measure())
        self.outputs: list[TaskOutput] = []

    def until(self, reached, limit_s: float = 20.0) -> TaskOutput:
        """Run until `reached(output)`; returns that output."""
        end_s = self.plant.time_s + limit_s
        while True:
            output = self.task.step(self.plant.measure(), TICK_S)
            self.outputs.append(output)
            self.plant.advance(output.command.joint_torque_nm, TICK_S)
            if reached(output):
                return output
            assert self.plant.time_s < end_s, f"never reached; {output.phase.name}, {self.queue.states()}"

    def hold(self, duration_s: float) -> None:
        end_s = self.plant.time_s + duration_s
        self.until(lambda _: self.plant.time_s >= end_s)

    @property
    def away_rad(self) -> float:
        return float(np.abs(self.plant.position_rad - self.home_rad).max())

    def events(self) -> list[str]:
        return [event.text for output in self.outputs for event in output.events]


def in_phase(phase: Phase):
    return lambda output: output.phase is phase


def test_reachable_targets_are_probed_in_order_with_the_tool_upright():
    rig = FollowerRig()
    rig.queue.take(intent(NEAR, target(1, 5.0), target(2, 0.40), ended=True))
    body, tilts = test_arm(), []

    def look(output: TaskOutput) -> bool:
        if output.phase in {Phase.LOADING, Phase.HOLD}:
            _, rotation = body.tip_pose(rig.plant.position_rad)
            tilts.append(float((rotation @ TOOL_AXIS_TIP)[2]))
        return output.done

    rig.until(look)
    assert rig.queue.states() == {0: TargetState.DONE, 1: TargetState.REFUSED, 2: TargetState.DONE}
    assert any("target 1 refused" in text for text in rig.events())
    runs = [output.run for output in rig.outputs if output.run >= 0]
    assert sorted(set(runs)) == [0, 1, 2, 3]
    assert runs == sorted(runs)
    assert rig.away_rad < 0.01
    assert len(tilts) > 100
    assert np.degrees(np.arccos(-np.array(tilts))).max() < 0.5


def test_nothing_starts_without_the_leader():
    rig = FollowerRig()
    rig.queue.take(intent(NEAR))
    rig.queue.linked = False
    rig.hold(0.5)
    assert rig.away_rad < 1e-3
    assert rig.queue.states() == {0: TargetState.QUEUED}
    rig.queue.linked = True
    rig.until(in_phase(Phase.LOADING))


@pytest.mark.parametrize(
    ("on_silence", "state"),
    [(SilenceAction.FINISH, TargetState.DONE), (SilenceAction.RETREAT, TargetState.CANCELLED)],
)
def test_lost_link_in_contact_ends_as_configured_and_keeps_the_queue(on_silence, state):
    rig = FollowerRig(on_silence)
    rig.queue.take(intent(NEAR, target(1, 0.40)))
    rig.until(in_phase(Phase.HOLD))
    rig.queue.linked = False
    rig.until(in_phase(Phase.IDLE))
    rig.hold(0.5)
    assert rig.queue.states() == {0: state, 1: TargetState.QUEUED}
    assert rig.away_rad < 0.01
    assert rig.plant.contact_force_n() == 0.0


@pytest.mark.parametrize("phase", [Phase.MOVE, Phase.FREE_AIR, Phase.APPROACH, Phase.LOADING, Phase.HOLD])
def test_target_can_be_canceled_at_any_time(phase):
    rig = FollowerRig()
    rig.queue.take(intent(NEAR))
    rig.until(in_phase(phase))
    rig.queue.take(intent(cancelled=(0,)))
    rig.until(in_phase(Phase.IDLE))
    assert rig.queue.states() == {0: TargetState.CANCELLED}
    assert rig.away_rad < 0.01
    assert not any(output.run > 0 for output in rig.outputs)


def test_repeated_lost_and_invalid_intents_change_nothing():
    queue = TargetQueue()
    queue.linked = True
    wanted = intent(NEAR, target(1, 0.40))
    for _ in range(3):
        queue.take(wanted)
    assert queue.begin() == NEAR
    assert queue.begin() is None  # one at a time
    queue.finish(TargetState.DONE)
    queue.take(wanted)
    assert queue.begin() == target(1, 0.40)
    queue.take(intent(cancelled=(0, 44)))
    assert not queue.cancelled
    queue.finish(TargetState.DONE)
    assert not queue.done
    queue.take(intent(ended=True))
    assert queue.done


def test_finished_targets_are_evicted_and_numbering_continues():
    queue = TargetQueue()
    queue.linked = True
    for number in range(200):
        queue.take(intent(*(target(n) for n in range(max(number - 20, 0), number + 1))))
        begun = queue.begin()
        assert begun is not None
        assert begun.number == number
        queue.finish(TargetState.DONE)
    assert len(queue.states()) <= 64


def test_new_leader_finds_an_empty_queue():
    queue = TargetQueue()
    queue.linked = True
    queue.take(intent(NEAR, target(1)))
    queue.begin()
    queue.clear()
    assert queue.cancelled
    assert queue.states() == {}
    newcomers = target(target_number(5, 0), 0.42)
    queue.take(intent(newcomers))
    assert queue.begin() is None
    queue.finish(TargetState.CANCELLED)
    assert queue.states() == {newcomers.number: TargetState.QUEUED}
    assert queue.begin() == newcomers


def test_leaders_never_share_target_numbers_and_users_see_short_ones():
    numbers = [target_number(leader, count) for leader in (3, 2**61 + 4) for count in range(100)]
    assert len(set(numbers)) == 200
    assert all(float(number) == number for number in numbers)  # sessions may hold them as doubles
    assert [short_number(number) for number in numbers] == [*range(100)] * 2
