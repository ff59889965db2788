"""One probing run: free-air record, approach, loading, hold, unloading, retract.

The surface is unknown: the approach ends when the force sensor detects the touch.
"""

import math
from collections.abc import Callable

from palpate.control.laws.gains import Gains
from palpate.control.laws.hybrid import ControlOutput, ForceGoal, HybridController, HybridReference
from palpate.control.laws.touch import RunningMean, free_air_problem, touch_force_n
from palpate.control.loop.task import Phase, TaskEvent
from palpate.control.paths.excitation import Profile, position_amplitude_m
from palpate.control.paths.trajectory import LineReturn, LineState, SpeedBlend, turning_distance_m
from palpate.control.probing.plan import ProbingPlan, ProbingRunSpec
from palpate.control.probing.sites import ProbingSite
from palpate.robot_io.types import Measurement

# Loading ends above this share of the force limit, below this share of the set speed or this speed.
_LOADED_SHARE, _SLOW_SHARE, _SLOW_M_S = 0.95, 0.1, 0.002
_HOLD_M_S = 0.02  # speed limit of a hold, so that the tip does not follow an object that has moved away
_LOST_S = 0.01  # time without contact in hold or excitation after which contact is lost
_MAX_FORCE_SHARE = 1.1  # share of the force limit that ends an excitation by position


class ProbingRun:
    """State machine of one run, from rest at a site's approach start to rest at the next approach start.

    Args:
        control: position and force controller.
        site: target, and limits along its press line.
        spec: number and speed of the run.
        plan: forces, times and distances.
        gains: gains of contact detection.

    Attributes:
        phase: phase of the last tick.
        desired_force_n: desired force in the last tick [N]; NaN if the force is free.
        events: events of the last tick.
        failure: reason why the run gave no data, or None.
        finished: whether the run has ended.
    """

    def __init__(
        self,
        control: HybridController,
        site: ProbingSite,
        spec: ProbingRunSpec,
        plan: ProbingPlan,
        gains: Gains,
    ) -> None:
        self._control, self._site, self._plan, self.spec = control, site, plan, spec
        self._touch_gains = gains.touch
        self._loading_goal = ForceGoal(plan.force_limit_n, spec.speed_m_s, hold=False)
        self._air, self._held = RunningMean(), RunningMean()
        self._step: Callable[[Measurement, float], ControlOutput] = self._free_air
        self._time_s = self._lost_s = 0.0
        self.phase = Phase.FREE_AIR
        self.desired_force_n = math.nan
        self.events: list[TaskEvent] = []
        self.failure: str | None = None
        self.finished = False

    def step(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        """Compute one tick.

        Args:
            measurement: state of the arm.
            dt_s: time since the last tick [s].
        """
        self._time_s += dt_s
        self.desired_force_n = math.nan
        self.events = []
        return self._step(measurement, dt_s)

    def cancel(self, reason: str) -> None:
        """Leave the object at once, and return to the start of the approach.

        Args:
            reason: reason, for the failure.
        """
        self.failure = self.failure or f"run {self.spec.run}: {reason}"
        if self.phase is Phase.FREE_AIR:
            self.finished = True
        elif self.phase is Phase.APPROACH:
            self._go_back()
        elif self.phase in (Phase.LOADING, Phase.HOLD):
            self._leave()

    def _free_air(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        still = LineState(self._site.approach_travel_m)
        output = self._control.step(measurement, HybridReference(free=still), dt_s)
        self._air.add(measurement.force_n)
        if self._time_s >= self._plan.free_air_s:
            # Tare, and set the touch force; or end the run.
            gains = self._touch_gains
            mean_n, noise_n = self._air.mean, self._air.standard_deviation
            touch_n = touch_force_n(noise_n, gains.touch_force_n)
            text = (
                f"free-air force {mean_n:.4f} N, noise {noise_n:.4f} N; a touch is detected above "
                f"{touch_n:.3f} N"
            )
            self._event("free_air", text, mean_n=mean_n, noise_n=noise_n, touch_n=touch_n)
            problem = free_air_problem(mean_n, touch_n, self._plan.force_limit_n, gains)
            self._control.tare(self._control.force_bias_n if problem else mean_n, touch_n)
            if problem:
                self.failure = f"run {self.spec.run}: {problem}"
                self._event("free_air_refused", self.failure, mean_n=mean_n, touch_n=touch_n)
                self.finished = True
            else:
                self._enter(Phase.APPROACH, self._approach)
                self._blend = SpeedBlend(still, self.spec.speed_m_s, self._plan.acceleration_m_s2)
        return output

    def _approach(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        reference = HybridReference(self._blend.at(self._time_s), self._loading_goal)
        output = self._control.step(measurement, reference, dt_s)
        if output.in_contact:
            self.desired_force_n = self._plan.force_limit_n
            speed_m_s, set_m_s = output.state.speed_m_s, self.spec.speed_m_s
            surface_m = self._control.surface_travel_m
            place = self._site.line.point_at(surface_m).tolist()
            travel = f"{1e3 * surface_m:.1f} mm from the start of the approach line"
            text = f"touch at {1e3 * speed_m_s:.0f} mm/s, {travel}"
            if speed_m_s < 0.98 * set_m_s:
                text += f"; the set speed {1e3 * set_m_s:.0f} mm/s was not reached yet"
            self._event("touch", text, surface_travel_m=surface_m, surface_world_m=place, tip_m_s=speed_m_s)
            self._site.approach_travel_m = max(surface_m - self._plan.retract_m, self._site.highest_travel_m)
            self._enter(Phase.LOADING, self._loading)
        elif output.state.travel_m >= self._site.search_travel_m or self._must_reverse(output):
            line, from_m = self._site.line, self._site.approach_travel_m
            start, end = line.point_at(from_m), line.point_at(output.state.travel_m)
            searched_mm = 1e3 * (output.state.travel_m - from_m)
            self.failure = (
                f"run {self.spec.run}: no touch within {searched_mm:.0f} mm, from z = "
                f"{1e3 * start[2]:.0f} mm to {1e3 * end[2]:.0f} mm: is the object there? "
                "(search_depth_m, targets_world_m)"
            )
            self._event("missed_surface", self.failure)
            self._go_back()
        return output

    def _loading(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        limit_n, set_m_s = self._plan.force_limit_n, self.spec.speed_m_s
        self.desired_force_n = limit_n
        output = self._control.step(measurement, HybridReference(force=self._loading_goal), dt_s)
        is_slow = abs(output.state.speed_m_s) < max(_SLOW_SHARE * set_m_s, _SLOW_M_S)
        if self._is_too_deep(output):
            self._leave()
        elif output.force_n >= _LOADED_SHARE * limit_n and is_slow:
            self._end_loading("limit_reached", output)
        elif self._time_s >= self._plan.load_time_limit_s:
            self._end_loading("load_time_limit", output)
        return output

    def _end_loading(self, kind: str, output: ControlOutput) -> None:
        depth_m = output.state.travel_m - self._control.surface_travel_m
        text = f"{output.force_n:.2f} N at {1e3 * depth_m:.2f} mm depth after {self._time_s:.3f} s of loading"
        self._event(kind, text, force_n=output.force_n, depth_m=depth_m, loading_s=self._time_s)
        self._enter(Phase.HOLD, self._hold)

    def _is_too_deep(self, output: ControlOutput) -> bool:
        """Return whether the depth limit is reached; logs an event."""
        depth_m = output.state.travel_m - self._control.surface_travel_m
        if not self._must_reverse(output, depth_m - self._plan.max_depth_m):
            return False
        text = f"reversed at a depth of {1e3 * depth_m:.1f} mm and {output.force_n:.2f} N"
        self._event("depth_limit", text, depth_m=depth_m, force_n=output.force_n)
        return True

    def _must_reverse(self, output: ControlOutput, beyond_m: float = -math.inf) -> bool:
        """Whether the tip must reverse now to stay within the site, or is `beyond_m` beyond another limit."""
        state = output.state
        beyond_m = max(beyond_m, state.travel_m - self._site.deepest_travel_m)
        return beyond_m + turning_distance_m(state.speed_m_s, self._plan.acceleration_m_s2) >= 0.0

    def _hold(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        slow_m_s = min(self.spec.speed_m_s, _HOLD_M_S)
        output = self._hold_force(measurement, self._plan.force_limit_n, slow_m_s, dt_s)
        if self._time_s > 0.5 * self._plan.hold_s:
            self._held.add(output.force_n)
        if self._time_s >= self._plan.hold_s and self.phase is Phase.HOLD:
            held = self._held
            text = f"held {held.mean:.3f} N +- {held.standard_deviation:.3f} N over the last half of the hold"
            self._event("held", text, mean_n=held.mean, spread_n=held.standard_deviation)
            excitation = self._plan.excitation
            if excitation is None:
                self._leave()
                return output
            self._event("excitation", f"{excitation.shape} of the {excitation.quantity} is added to the hold")
            self._rest_travel_m = self._control.state.travel_m
            if excitation.quantity == "force":
                self._profile, self._amplitude = Profile(excitation), excitation.amplitude_n
                self._enter(Phase.HOLD, self._excite_force)
            else:
                self._amplitude, offset = position_amplitude_m(
                    excitation,
                    **self._control.quick_estimator.compliance._asdict(),
                    force_limit_n=self._plan.force_limit_n,
                    speed_limit_m_s=self._plan.travel_speed_m_s,
                )
                self._profile = Profile(excitation, offset)
                self._enter(Phase.HOLD, self._excite_position)
        return output

    def _hold_force(
        self, measurement: Measurement, force_n: float, speed_limit_m_s: float, dt_s: float
    ) -> ControlOutput:
        self.desired_force_n = force_n
        reference = HybridReference(force=ForceGoal(force_n, speed_limit_m_s, hold=True))
        output = self._control.step(measurement, reference, dt_s)
        if self._is_lost(output, dt_s) or self._is_too_deep(output):
            self._leave()
        return output

    def _is_lost(self, output: ControlOutput, dt_s: float) -> bool:
        """Return whether contact was lost; logs an event."""
        self._lost_s = 0.0 if output.in_contact else self._lost_s + dt_s
        if self._lost_s < _LOST_S:
            return False
        self.failure = (
            f"run {self.spec.run}: contact lost while holding: the force is {output.force_n:.3f} N "
            f"instead of {self._plan.force_limit_n:g} N; has the object moved?"
        )
        self._event("contact_lost", self.failure, force_n=output.force_n)
        return True

    def _excite_force(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        desired_n = self._plan.force_limit_n + self._amplitude * self._profile.at(self._time_s)[0]
        output = self._hold_force(measurement, desired_n, self.spec.speed_m_s, dt_s)
        if self._time_s >= self._profile.duration_s and self.phase is Phase.HOLD:
            self._leave()
        return output

    def _excite_position(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        travel_m, speed_m_s, acceleration_m_s2 = (self._amplitude * x for x in self._profile.at(self._time_s))
        free = LineState(self._rest_travel_m + travel_m, speed_m_s, acceleration_m_s2)
        output = self._control.step(measurement, HybridReference(free=free), dt_s)
        if self._is_lost(output, dt_s):
            self._leave()
        elif output.force_n > _MAX_FORCE_SHARE * self._plan.force_limit_n:
            text = f"excitation ended early: {output.force_n:.2f} N is above the force limit"
            self._event("excitation_too_strong", text, force_n=output.force_n)
            self._leave()
        elif self._time_s >= self._profile.duration_s:
            self._leave()
        return output

    def _leave(self) -> None:
        """Move out, at the set speed while in contact."""
        start = self._control.state._replace(acceleration_m_s2=0.0)
        self._blend = SpeedBlend(start, -self.spec.speed_m_s, self._plan.acceleration_m_s2)
        self._enter(Phase.UNLOADING, self._unloading)

    def _unloading(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        reference = HybridReference(free=self._blend.at(self._time_s))
        output = self._control.step(measurement, reference, dt_s)
        half_way_m = self._control.surface_travel_m - 0.5 * self._plan.retract_m
        if not output.in_contact or output.state.travel_m < half_way_m:
            kind = "still_in_contact" if output.in_contact else "release"
            self._event(kind, f"{kind.replace('_', ' ')}: {output.force_n:.3f} N", force_n=output.force_n)
            self._go_back()
        return output

    def _go_back(self) -> None:
        """Return to the start of the next approach."""
        plan, travel_m = self._plan, self._site.approach_travel_m
        start = self._control.state
        self._return = LineReturn(start, travel_m, plan.travel_speed_m_s, plan.acceleration_m_s2)
        self._enter(Phase.RETRACT, self._retract)

    def _retract(self, measurement: Measurement, dt_s: float) -> ControlOutput:
        reference = HybridReference(free=self._return.at(self._time_s))
        output = self._control.step(measurement, reference, dt_s)
        self.finished = self._time_s >= self._return.duration_s
        return output

    def _enter(self, phase: Phase, step: Callable[[Measurement, float], ControlOutput]) -> None:
        self.phase = phase
        self._step = step
        self._time_s = 0.0

    def _event(self, kind: str, text: str, **data: object) -> None:
        about = {"run": self.spec.run, "target": self.spec.target, "speed_m_s": self.spec.speed_m_s}
        self.events.append(TaskEvent(kind, text, about | data))
