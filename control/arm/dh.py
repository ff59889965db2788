"""Denavit-Hartenberg tables (standard convention): file format and forward kinematics.

Row i places frame i in frame i-1 as

    T = Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha)

with theta = joint position + `theta_rad` for a revolute joint, d = joint position + `d_m` for a prismatic
one, and neither for a fixed row (which places the first axis in the world, or the tool on the last link).
Denavit and Hartenberg, J. Applied Mechanics 22, 1955; Siciliano et al., "Robotics", Springer 2009,
section 2.8.2.

    name: example
    rows:
      - {name: base, type: fixed, alpha_rad: -1.5707963267948966}   # joint axes along world y
      - {name: joint_1, type: revolute, a_m: 0.3}
      - {name: joint_2, type: revolute, a_m: 0.25, theta_rad: 0.0, d_m: 0.0, alpha_rad: 0.0}
"""

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from robot_io.errors import InputError
from robot_io.files.file_model import FileModel, Number, matching, validate
from robot_io.files.safe_yaml import YamlDocument, load_yaml
from robot_io.types import FloatArray, frozen_array

Name = Annotated[str, matching(r"[A-Za-z][A-Za-z0-9_]{0,63}", "1 to 64 letters, digits or _, a letter first")]


class DhRow(FileModel):
    """One row of the table.

    Attributes:
        name: of the joint, or of what a fixed row stands for.
        type: what moves.
        theta_rad: turn about the previous z, or its offset for a revolute joint [rad].
        d_m: shift along the previous z, or its offset for a prismatic joint [m].
        a_m: shift along the new x [m].
        alpha_rad: turn about the new x [rad].
    """

    name: Name
    type: Literal["revolute", "prismatic", "fixed"]
    theta_rad: Number = 0.0
    d_m: Number = 0.0
    a_m: Number = 0.0
    alpha_rad: Number = 0.0

    def before_joint(self) -> FloatArray:
        """The part of the row's transform that comes before the joint's motion, (4, 4)."""
        return rotation_z(self.theta_rad)

    def after_joint(self) -> FloatArray:
        """The part that comes after it, (4, 4)."""
        return translation(0.0, 0.0, self.d_m) @ translation(self.a_m, 0.0, 0.0) @ rotation_x(self.alpha_rad)

    def transform(self, position: float = 0.0) -> FloatArray:
        """Frame i in frame i-1, (4, 4), at a joint position [rad or m] (no meaning for a fixed row)."""
        motion = np.eye(4)
        if self.type == "revolute":
            motion = rotation_z(position)
        elif self.type == "prismatic":
            motion = translation(0.0, 0.0, position)
        return self.before_joint() @ motion @ self.after_joint()


class DhTable(FileModel):
    """An arm as a table of rows from the world to the tip."""

    name: Name
    rows: Annotated[tuple[DhRow, ...], Field(min_length=1, max_length=64)]

    @model_validator(mode="after")
    def _check_rows(self) -> "DhTable":
        names = [row.name for row in self.rows]
        if len(set(names)) != len(names):
            raise ValueError(f"two rows have the same name: {', '.join(names)}")
        if not any(row.type != "fixed" for row in self.rows):
            raise ValueError("no row is a joint; type is one of revolute, prismatic, fixed")
        return self

    @property
    def joint_rows(self) -> tuple[DhRow, ...]:
        """The rows that move, in the order of joint positions."""
        return tuple(row for row in self.rows if row.type != "fixed")

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.joint_rows)

    def frames(self, position_rad: FloatArray) -> tuple[FloatArray, ...]:
        """The frame after each row in the world, (4, 4) each, at joint positions (n,) [rad or m].

        Raises:
            InputError: wrong number of positions.
        """
        positions = iter(frozen_array(position_rad, (self.joint_count,), what="joint positions"))
        frame = np.eye(4)
        frames = []
        for row in self.rows:
            frame = frame @ row.transform(0.0 if row.type == "fixed" else next(positions))
            frames.append(frame)
        return tuple(frames)

    def tip_frame(self, position_rad: FloatArray) -> FloatArray:
        """Forward kinematics: the last frame in the world, (4, 4)."""
        return self.frames(position_rad)[-1]


def load_dh_table(source: str | Path | YamlDocument) -> DhTable:
    """Read a DH table from a YAML file.

    Raises:
        InputError: with file, line, key and the valid choices.
    """
    document = source if isinstance(source, YamlDocument) else load_yaml(source)
    return validate(DhTable, document.data, document)


def rotation_z(angle_rad: float) -> FloatArray:
    """Turn about z, (4, 4)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def rotation_x(angle_rad: float) -> FloatArray:
    """Turn about x, (4, 4)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0], [0.0, 0.0, 0.0, 1.0]])


def translation(x_m: float, y_m: float, z_m: float) -> FloatArray:
    """Shift, (4, 4) [m]."""
    shift = np.eye(4)
    shift[:3, 3] = x_m, y_m, z_m
    return shift


def rpy_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Fixed-axis roll, pitch and yaw [rad] of a rotation (3, 3), as URDF writes them.

    Raises:
        InputError: it is not a rotation.
    """
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9):
        raise InputError("roll, pitch and yaw: the matrix is not a rotation")
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.cos(pitch) < 1e-9:  # gimbal lock: yaw may be chosen
        return math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])
