"""Parameters of a whole arm, shared by all its joints in one fit; see docs/arm-identification.md."""

from estimation.arm.arm_columns import payload_columns, tilt_columns
from estimation.arm.arm_estimate import ArmEstimate
from estimation.arm.base_parameters import BaseParameters, base_parameters
from estimation.arm.channels import rows_of_channels
from estimation.arm.held_out import HeldOut, held_out
from estimation.arm.identify import identify
from estimation.arm.normal_equations import JointMoments, arranged, information_of_others, joint_moments
from estimation.arm.prior import urdf_information
from estimation.arm.rows import ArmRows, arm_rows
from estimation.information import Information

__all__ = [
    "ArmEstimate",
    "ArmRows",
    "BaseParameters",
    "HeldOut",
    "Information",
    "JointMoments",
    "arm_rows",
    "arranged",
    "base_parameters",
    "held_out",
    "identify",
    "information_of_others",
    "joint_moments",
    "payload_columns",
    "rows_of_channels",
    "tilt_columns",
    "urdf_information",
]
