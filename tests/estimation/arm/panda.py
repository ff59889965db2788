"""A published arm of seven joints (URDF from the package example-robot-data), and motion and noise for it."""

from importlib.metadata import files

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.arm.pseudo_inertia import inertial_of, nearest_bodies, pseudo_inertias

TIP = "panda_link8"
JOINTS = 7
HOME = np.array([0, -0.3, 0, -1.5, 0, 1.5, 0])  # [rad]


def panda_urdf() -> str:
    """The Panda, its fingers held."""
    (path,) = (f for f in files("example-robot-data") if f.match("panda_description/urdf/panda.urdf"))
    return path.read_text().replace('type="prismatic"', 'type="fixed"')


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
    """Bodies of other masses, centres and inertias than those of the URDF: P = L exp(S) L', S symmetric."""
    factor = np.linalg.cholesky(pseudo_inertias(nearest_bodies(urdf)))
    change = spread * rng.normal(size=factor.shape)
    change = np.array([expm(0.5 * (one + one.T)) for one in change])
    return inertial_of(factor @ change @ factor.transpose(0, 2, 1))


def coloured_noise(rng, run, joints, noise_model=0.7):
    """AR(1) of standard deviation 1 that begins anew with each run, shape (n, joints)."""
    parts = []
    for number in np.unique(run):
        count = np.count_nonzero(run == number)
        white = rng.normal(size=(count + 100, joints)) * np.sqrt(1 - noise_model**2)
        parts.append(lfilter([1.0], [1.0, -noise_model], white, axis=0)[100:])
    return np.concatenate(parts)
