"""A seven-joint arm with the kinematics of Franka's arms, and motion and noise for it."""

from functools import cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.arm.inertial_parameters import inertial_of, nearest_bodies, pseudo_inertias
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.arm_signals import ARM_MOTION

TIP = "tip"
JOINTS = 7
HOME = np.array([0, -0.3, 0, -1.5, 0, 1.5, 0])  # [rad]
# Craig's a [m], d [m] and alpha [quarter turns] of each joint, as the maker publishes them.
DH = [
    *[(0, 0.333, 0), (0, 0, -1), (0, 0.316, 1), (0.0825, 0, 1)],
    *[(-0.0825, 0.384, -1), (0, 0, 1), (0.088, 0, 1)],
]
# Made up: mass [kg], center [m] and radii of gyration [m] of each link; no link is symmetric.
LINKS = [
    (3.1, (0.01, -0.03, -0.12), (0.13, 0.12, 0.07)),
    (2.8, (-0.01, -0.09, 0.02), (0.12, 0.07, 0.13)),
    (2.5, (0.04, 0.02, -0.07), (0.09, 0.1, 0.06)),
    (2.4, (-0.05, 0.06, 0.02), (0.08, 0.09, 0.1)),
    (2.9, (0.01, 0.05, -0.13), (0.14, 0.13, 0.06)),
    (1.5, (0.05, -0.01, 0.01), (0.05, 0.07, 0.06)),
    (0.9, (0.01, 0.02, 0.07), (0.04, 0.05, 0.03)),
]


@cache
def panda_urdf() -> str:
    """The arm; its tip is 0.107 m beyond the last joint."""
    parts = ['<robot name="seven_joints"><link name="link0"/>']
    for number, ((a, d, turns), (mass, center, radii)) in enumerate(zip(DH, LINKS, strict=True), 1):
        x, y, z = center
        ixx, iyy, izz = (mass * radius**2 for radius in radii)
        products = f'ixy="{0.1 * ixx}" ixz="{-0.1 * iyy}" iyz="{0.05 * izz}"'
        parts.append(
            f'<link name="link{number}"><inertial><mass value="{mass}"/><origin xyz="{x} {y} {z}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" {products}/>'
            "</inertial></link>"
            f'<joint name="joint{number}" type="revolute"><parent link="link{number - 1}"/>'
            f'<child link="link{number}"/><axis xyz="0 0 1"/>'
            f'<origin rpy="{turns * np.pi / 2} 0 0" xyz="{a} {-d if turns == 1 else d * (turns == -1)} '
            f'{d * (turns == 0)}"/><limit lower="-2.9" upper="2.9" effort="87" velocity="2"/></joint>'
        )
    parts.append(
        f'<link name="{TIP}"/><joint name="flange" type="fixed"><parent link="link{JOINTS}"/>'
        f'<child link="{TIP}"/><origin xyz="0 0 0.107"/></joint></robot>'
    )
    return "".join(parts)


def panda() -> RigidBody:
    return RigidBody.from_urdf(panda_urdf(), TIP)


def motion(rng, *, runs=4, seconds=10.0, rate_hz=100.0, size=1.0, moving=range(JOINTS)):
    """Sums of sines in each joint that moves: positions, velocities, accelerations (n, 7); run numbers."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    parts = []
    for _ in range(runs):
        f = rng.uniform(0.1, 0.8, (JOINTS, 4))
        w, phase, reach = 2 * np.pi * f, rng.uniform(0, 6.3, (JOINTS, 4)), size * 0.3 / (0.5 + f)
        reach[[j for j in range(JOINTS) if j not in moving]] = 0.0
        angle = t[:, None, None] * w + phase
        parts.append(
            [
                (reach * np.sin(angle)).sum(2) + HOME,
                (reach * w * np.cos(angle)).sum(2),
                (-reach * w**2 * np.sin(angle)).sum(2),
            ]
        )
    whole = tuple(np.concatenate([part[i] for part in parts]) for i in range(3))
    return whole, np.repeat(np.arange(runs), len(t))


def joint_channels(time_s, motion, torque, run):
    """Channels of all joints of an arm, from positions, velocities, accelerations and torques (n, joints)."""
    context = dict(zip(ARM_MOTION, motion, strict=True))
    return [
        ChannelData(f"joint_{j + 1}", ChannelKind.REVOLUTE, time_s, *signals, run, 0 * run - 1, context)
        for j, signals in enumerate(zip(*(part.T for part in (*motion, torque)), strict=True))
    ]


def regressor(body, q, v, a):
    """Shape (n, 7, 70): joint torques are linear in the links' ten parameters each."""
    return np.array([body.regressor(*row) for row in zip(q, v, a, strict=True)])


def is_body(inertial) -> bool:
    """Whether each link's parameters (10 links,) belong to some distribution of positive mass."""
    return bool(np.all(np.linalg.eigvalsh(pseudo_inertias(inertial)) > 0.0))


def minimum(information):
    """The parameters at the minimum of quadratics, shape (..., s), whatever the units."""
    scale = 1.0 / np.sqrt(np.diagonal(information.matrix, axis1=-2, axis2=-1))
    scaled = information.matrix * scale[..., :, None] * scale[..., None, :]
    return scale * np.linalg.solve(scaled, (information.vector * scale)[..., None])[..., 0]


def other_bodies(rng, urdf, spread=0.2):
    """Bodies of other masses, centers and inertias than those of the URDF: P = L exp(S) L', S symmetric."""
    factor = np.linalg.cholesky(pseudo_inertias(nearest_bodies(urdf)))
    change = spread * rng.normal(size=factor.shape)
    change = np.array([expm(0.5 * (one + one.T)) for one in change])
    return inertial_of(factor @ change @ factor.transpose(0, 2, 1))


def colored_noise(rng, run, joints, noise_model=0.7):
    """AR(1) of standard deviation 1 that begins anew with each run, shape (n, joints)."""
    parts = []
    for number in np.unique(run):
        count = np.count_nonzero(run == number)
        white = rng.normal(size=(count + 100, joints)) * np.sqrt(1 - noise_model**2)
        parts.append(lfilter([1.0], [1.0, -noise_model], white, axis=0)[100:])
    return np.concatenate(parts)
