"""Rigid body, controllers, the real-time loop and the probing task."""

from control.admittance import Admittance, loading_acceleration, scheduled_admittance
from control.computed_torque import ComputedTorque
from control.dh import DhRow, DhTable, load_dh_table
from control.dh_urdf import JointRange, LinkInertia, dh_to_urdf
from control.excitation import Excitation, Profile
from control.gains import Gains, gains_of
from control.hybrid import ContactSwitch, ControlOutput, ForceGoal, HybridController, HybridReference
from control.inverse_kinematics import Elbow, IkSolution, PlanarArm
from control.journal import Journal, Observer
from control.loop import run_loop
from control.loop_result import LoopResult, Outcome
from control.motion import JointMotion, LineState
from control.object_guess import Compliance, ObjectGuess
from control.phases import Phase
from control.pid import Pid
from control.press_line import PressLine
from control.probing import ProbingTask
from control.probing_plan import ProbingPlan, ProbingRunSpec, load_probing_plan
from control.rigid_body import JointAxis, RigidBody, TipMotion
from control.task import NO_RUN, Task, TaskEvent, TaskOutput
from control.tick_record import Estimates, tick_record, tick_stream
from control.timing import TickDurations
from control.trajectory import JointMove, LineReturn, SpeedBlend

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
