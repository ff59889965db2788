"""An independent plant: Pinocchio's forward dynamics and a Kelvin-Voigt object, in short steps.

It shares no code with the simulator, so that a controller that works on both did not learn one by heart.
"""

from dataclasses import dataclass, field
from itertools import accumulate
from math import cos, sin

import numpy as np
import pinocchio as pin

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.types import Measurement

SUBSTEP_S = 0.00025
RODS = ((1.8, 0.32), (1.2, 0.28), (0.5, 0.12))  # mass [kg] and length [m]
JOINT = """
  <link name="joint_{i}_link"><inertial><origin xyz="{middle} 0 0"/><mass value="{mass}"/>
    <inertia ixx="2e-4" iyy="{across}" izz="{across}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint_{i}" type="{kind}"><parent link="{parent}"/><child link="joint_{i}_link"/>
    <origin {origin}/><axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="99" velocity="9"/>
  </joint>"""
TIP = """<link name="tip"/>
  <joint name="end" type="fixed"><parent link="joint_3_link"/><child link="tip"/><origin {origin}/></joint>"""


def arm_urdf(
    origins=('xyz="0 0 0"', 'xyz="0.32 0 0"', 'xyz="0.28 0 0"', 'xyz="0.12 0 0"'),
    axes=("0 1 0",) * 3,
    kinds=("revolute",) * 3,
    limits=((-np.pi, np.pi),) * 3,
) -> str:
    """An arm of three slender rods along x; the origins are those of its joints and of its tip."""
    text, parent = "", "base_link"
    for i, (mass, length) in enumerate(RODS):
        rod = {"mass": mass, "middle": length / 2, "across": mass * length**2 / 12}
        joint = {"origin": origins[i], "axis": axes[i], "kind": kinds[i], "parent": parent}
        text += JOINT.format(i=i + 1, low=limits[i][0], high=limits[i][1], **joint, **rod)
        parent = f"joint_{i + 1}_link"
    return f'<robot name="arm"><link name="base_link"/>{text}{TIP.format(origin=origins[3])}</robot>'


URDF = arm_urdf()
TOOL_AXIS_TIP = np.array([1.0, 0.0, 0.0])
TORQUE_LIMIT_NM = np.array([60.0, 40.0, 20.0])
DOWN = np.array([0.0, 0.0, -1.0])
NOTHING = np.zeros(3)


def test_arm() -> RigidBody:
    return RigidBody.from_urdf(URDF, "tip")


test_arm.__test__ = False


@dataclass
class ReferencePlant:
    """An arm above a Kelvin-Voigt object with a horizontal surface; pressing down is positive."""

    position_rad: np.ndarray
    stiffness_n_m: float = 500.0
    damping_n_s_m: float = 20.0
    surface_height_m: float = 0.05
    force_noise_n: float = 0.0
    force_bias_n: float = 0.0
    velocity_noise_rad_s: float = 0.0
    force_delay_ticks: int = 0
    body: RigidBody = field(default_factory=test_arm)
    seed: int = 0

    def __post_init__(self) -> None:
        self.velocity_rad_s = np.zeros(3)
        self.torque_nm = np.zeros(3)
        self.time_s = 0.0
        self.generator = np.random.default_rng(self.seed)
        self.force_history = [0.0]

    def contact(self) -> tuple[float, np.ndarray]:
        """Force of the object [N], and the torques with which it pushes the joints, shape (3,) [N m]."""
        (_, first_m), (_, second_m), (_, third_m) = RODS
        one, two, three = accumulate(self.position_rad.tolist())  # angles of the rods below the x axis
        height_m = -first_m * sin(one) - second_m * sin(two) - third_m * sin(three)
        if height_m >= self.surface_height_m:
            return 0.0, NOTHING
        by_third = -third_m * cos(three)  # rise of the tip per angle of the third joint [m/rad]
        by_second = by_third - second_m * cos(two)
        rise_m = np.array([by_second - first_m * cos(one), by_second, by_third])
        spring_n = self.stiffness_n_m * (self.surface_height_m - height_m)
        force_n = max(spring_n - self.damping_n_s_m * (rise_m @ self.velocity_rad_s), 0.0)
        return force_n, force_n * rise_m

    def contact_force_n(self) -> float:
        return self.contact()[0]

    def noise(self, std: float, count: int | None = None):
        return self.generator.normal(0.0, std, count) if std else 0.0

    def measure(self) -> Measurement:
        self.force_history.append(self.contact_force_n())
        delayed = self.force_history[max(len(self.force_history) - 1 - self.force_delay_ticks, 0)]
        return Measurement(
            time_s=self.time_s,
            joint_position_rad=self.position_rad.copy(),
            joint_velocity_rad_s=self.velocity_rad_s + self.noise(self.velocity_noise_rad_s, 3),
            joint_torque_nm=self.torque_nm.copy(),
            force_n=delayed + self.force_bias_n + self.noise(self.force_noise_n),
            encoder_at_s=self.time_s,
            torque_at_s=self.time_s,
            force_at_s=self.time_s,
        )

    def advance(self, torque_nm: np.ndarray, duration_s: float) -> None:
        self.torque_nm = np.clip(torque_nm, -TORQUE_LIMIT_NM, TORQUE_LIMIT_NM)
        model, data = self.body._model, self.body._data
        for _ in range(round(duration_s / SUBSTEP_S)):
            _, pushed_nm = self.contact()
            torque_nm = self.torque_nm if pushed_nm is NOTHING else self.torque_nm + pushed_nm
            acceleration = pin.aba(model, data, self.position_rad, self.velocity_rad_s, torque_nm)
            self.velocity_rad_s += acceleration * SUBSTEP_S
            self.position_rad += self.velocity_rad_s * SUBSTEP_S
        self.time_s += duration_s
