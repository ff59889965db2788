"""Rigid body, controllers, the real-time loop and the probing task."""

from control.arm.dh import DhRow, DhTable, load_dh_table
from control.arm.dh_urdf import JointRange, LinkInertia, dh_to_urdf
from control.arm.inverse_kinematics import Elbow, IkSolution, PlanarArm
from control.arm.rigid_body import JointAxis, RigidBody, TipMotion
from control.compliance import Compliance
from control.laws.admittance import Admittance, loading_acceleration, scheduled_admittance
from control.laws.computed_torque import ComputedTorque
from control.laws.gains import Gains, gains_of
from control.laws.hybrid import ContactSwitch, ControlOutput, ForceGoal, HybridController, HybridReference
from control.laws.object_guess import ObjectGuess
from control.laws.pid import Pid
from control.loop.journal import Journal, Observer
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.result import LoopResult, Outcome
from control.loop.task import NO_RUN, Task, TaskEvent, TaskOutput
from control.loop.tick_record import Estimates, tick_record, tick_stream
from control.loop.timing import TickDurations
from control.paths.excitation import Excitation, Profile
from control.paths.motion import JointMotion, LineState
from control.paths.press_line import PressLine
from control.paths.trajectory import JointMove, LineReturn, SpeedBlend
from control.probing.plan import ProbingPlan, ProbingRunSpec, load_probing_plan
from control.probing.task import ProbingTask

__all__ = [
    "NO_RUN",
    "Admittance",
    "Compliance",
    "ComputedTorque",
    "ContactSwitch",
    "ControlOutput",
    "DhRow",
    "DhTable",
    "Elbow",
    "Estimates",
    "Excitation",
    "ForceGoal",
    "Gains",
    "HybridController",
    "HybridReference",
    "IkSolution",
    "JointAxis",
    "JointMotion",
    "JointMove",
    "JointRange",
    "Journal",
    "LineReturn",
    "LineState",
    "LinkInertia",
    "LoopResult",
    "ObjectGuess",
    "Observer",
    "Outcome",
    "Phase",
    "Pid",
    "PlanarArm",
    "PressLine",
    "ProbingPlan",
    "ProbingRunSpec",
    "ProbingTask",
    "Profile",
    "RigidBody",
    "SpeedBlend",
    "Task",
    "TaskEvent",
    "TaskOutput",
    "TickDurations",
    "TipMotion",
    "dh_to_urdf",
    "gains_of",
    "load_dh_table",
    "load_probing_plan",
    "loading_acceleration",
    "run_loop",
    "scheduled_admittance",
    "tick_record",
    "tick_stream",
]
