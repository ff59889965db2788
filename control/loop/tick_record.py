"""What a session keeps of every tick: the stream called "tick", and its records."""

import math

from control.loop.phases import Phase
from control.loop.task import TaskOutput
from control.loop.timing import TickDurations
from robot_io.session import Column, Stream
from robot_io.types import FloatArray, Measurement

STREAM_NAME = "tick"
Estimates = tuple[float, float, float]
"""Online estimates of stiffness [N/m], damping [N s/m], and the surface along the press direction [m]."""

NO_ESTIMATE: Estimates = (math.nan, math.nan, math.nan)


def tick_stream(joint_count: int) -> Stream:
    """The columns of a tick of an arm with n joints."""
    n = joint_count
    phases = ", ".join(f"{phase.value} {phase.name}" for phase in Phase)
    status = "0 OK, 1 STALE, 2 SATURATED, 3 FAULT"
    return Stream(
        STREAM_NAME,
        (
            Column("tick", "1", 1, "number of the tick on the loop's grid; a gap is an overrun", "int64"),
            Column("time_s", "s", 1, "start of the tick on the robot's clock", "float64"),
            Column("run", "1", 1, "number of the probing run, -1 between runs", "int32"),
            Column("phase", "1", 1, phases, "int32"),
            Column("joint_position_rad", "rad", n, "measured", "float64"),
            Column("joint_velocity_rad_s", "rad/s", n, "measured", "float64"),
            Column("torque_measured_nm", "N m", n, "measured by the drives", "float64"),
            Column("torque_commanded_nm", "N m", n, "wanted by the controller; 0 in STOPPED", "float64"),
            Column("torque_sent_nm", "N m", n, "really sent; NaN if sending failed", "float64"),
            Column("force_n", "N", 1, "contact force, positive in compression", "float64"),
            Column("reference_position_rad", "rad", n, "aimed at", "float64"),
            Column("reference_velocity_rad_s", "rad/s", n, "aimed at", "float64"),
            Column("tip_position_world_m", "m", 3, "of the measured joints", "float64"),
            Column("tip_velocity_world_m_s", "m/s", 3, "of the measured joints", "float64"),
            Column("press_direction_world", "1", 3, "unit vector into the object", "float64"),
            Column("desired_force_n", "N", 1, "aimed at; NaN where the force is free", "float64"),
            Column("encoder_at_s", "s", 1, "when the encoders sampled", "float64"),
            Column("torque_at_s", "s", 1, "when the torques were sampled", "float64"),
            Column("force_at_s", "s", 1, "when the force was sampled", "float64"),
            Column("encoder_status", "1", 1, status, "int32"),
            Column("torque_status", "1", 1, status, "int32"),
            Column("force_status", "1", 1, status, "int32"),
            Column("guard_tripped", "1", 1, "true once the guard has tripped", "bool"),
            Column("stiffness_n_m", "N/m", 1, "online estimate, NaN if none", "float64"),
            Column("damping_n_s_m", "N s/m", 1, "online estimate, NaN if none", "float64"),
            Column("surface_m", "m", 1, "online estimate along the press direction, NaN if none", "float64"),
            # In the order of `TickDurations`.
            Column("read_s", "s", 1, "time spent reading the robot", "float64"),
            Column("control_s", "s", 1, "time spent in the task", "float64"),
            Column("guard_s", "s", 1, "time spent in the guard", "float64"),
            Column("write_s", "s", 1, "time spent writing the command", "float64"),
            Column("observer_s", "s", 1, "time spent in the online estimator", "float64"),
            Column("log_s", "s", 1, "time spent logging the tick before", "float64"),
            Column("lateness_s", "s", 1, "woken up after the tick was due", "float64"),
        ),
    )


def tick_record(  # noqa: PLR0917 (what a tick is made of)
    tick: int,
    measurement: Measurement,
    output: TaskOutput,
    sent_torque_nm: FloatArray,
    tripped: bool,
    estimates: Estimates,
    durations: TickDurations,
) -> tuple[object, ...]:
    """One record of `tick_stream`, with a value for each column."""
    return (
        tick,
        measurement.time_s,
        output.run,
        output.phase,
        measurement.joint_position_rad,
        measurement.joint_velocity_rad_s,
        measurement.joint_torque_nm,
        output.command.joint_torque_nm,
        sent_torque_nm,
        measurement.force_n,
        output.reference_position_rad,
        output.reference_velocity_rad_s,
        output.tip_position_world_m,
        output.tip_velocity_world_m_s,
        output.press_direction_world,
        output.desired_force_n,
        measurement.encoder_at_s,
        measurement.torque_at_s,
        measurement.force_at_s,
        measurement.encoder_status,
        measurement.torque_status,
        measurement.force_status,
        tripped,
        *estimates,
        *durations,
    )
