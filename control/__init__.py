"""Rigid body, controllers, the real-time loop and the probing task."""

from control.arm.dh import load_dh_table
from control.arm.dh_urdf import dh_to_urdf
from control.arm.inverse_kinematics import PlanarArm
from control.arm.rigid_body import RigidBody
from control.laws.gains import Gains
from control.laws.hybrid import HybridController
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.result import LoopResult
from control.loop.task import Task, TaskOutput
from control.probing.plan import ProbingPlan, load_probing_plan
from control.probing.task import ProbingTask

__all__ = [
    "Gains",
    "HybridController",
    "LoopResult",
    "Phase",
    "PlanarArm",
    "ProbingPlan",
    "ProbingTask",
    "RigidBody",
    "Task",
    "TaskOutput",
    "dh_to_urdf",
    "load_dh_table",
    "load_probing_plan",
    "run_loop",
]
