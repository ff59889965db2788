"""One session with a known answer: motion, object or joint, sensor, noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter
from synthetic import contact, joint
from synthetic.motion import Motion, measured, presses
from synthetic.sensors import FAULTS
from synthetic.truth import OF_THE_JOINT, Facts, of_effect
from synthetic.ways import WAYS, Way, derived, imported, steps_seen, usual_swings

from estimation.channel import ChannelData, ChannelKind

FLOOR = {ChannelKind.CONTACT: 0.05, ChannelKind.REVOLUTE: 0.02}  # standard deviation of the noise
LEAST = 3.0  # times the floor, that each of several effects shows beside the others; the weakest shown alone
DRY = {"coulomb_friction", "stribeck_friction", "asymmetric_friction", "load_dependent_friction"}
ENCODER = {ChannelKind.CONTACT: (1e-6, 1e-6), ChannelKind.REVOLUTE: (2e-5, 1e-5)}  # noise and step


@dataclass(frozen=True)
class Scene:
    """What is hidden, and how the session is made."""

    kind: ChannelKind  # contact or joint
    # Effects with their strength, RMS of what the base model cannot mimic over the noise.
    hidden: Mapping[str, float] = field(default_factory=dict)
    correlation: float = 0.0  # of the noise from one sample to the next
    seed: int = 0  # decides all that is random
    way: str = ""  # in which it comes about and is read, see `WAYS`; empty for the usual one


@dataclass(frozen=True)
class Made:
    """A session made."""

    data: ChannelData  # its channel
    truth: dict[str, float]  # parameters of the base model and of what is hidden, by "effect.parameter"
    # Error that the true law leaves: the noise as drawn (a coloured one is up to a tenth larger or smaller in
    # so short a session than on the average), and beside dry friction what the error of the motion makes of
    # it (that turns round where the derived velocity does, a millisecond off).
    floor: float


def names(kind: ChannelKind) -> tuple[str, ...]:
    """Effects that can be hidden in such a channel."""
    return (*(contact.OBJECT if kind is ChannelKind.CONTACT else joint.JOINT), *FAULTS)


def make(scene: Scene) -> Made | None:
    """The session, or None where an effect cannot reach its strength at any size."""
    rng = np.random.default_rng(scene.seed)
    touching = scene.kind is ChannelKind.CONTACT
    way = WAYS[scene.kind].get(scene.way, Way(presses if touching else usual_swings))
    k, c = 10.0 ** rng.uniform(*way.stiffness), rng.uniform(5.0, 30.0)
    motion = way.motion(rng, 10.0 / k if touching else 1.0)
    seen_x = steps_seen(way, motion.x, FLOOR[scene.kind] / k, np.random.default_rng([scene.seed, 1]))
    noise = float(np.hypot(FLOOR[scene.kind], _through_position(scene, motion, seen_x, k)))
    shape = {name: float(rng.uniform()) for name in names(scene.kind)}
    basis = np.linalg.qr(_columns(motion, touching))[0]

    def effort(sizes: Mapping[str, float], alone: bool = True, by: Motion = motion) -> np.ndarray:
        clean = contact.force(by, k, c, sizes, shape) if touching else joint.torque(by, sizes, shape)
        scale = float(np.sqrt(np.mean(clean**2)))
        for name in sizes:
            if name in FAULTS and (name != "quantisation" or alone):
                clean = FAULTS[name](clean, by, sizes[name], scale, shape[name])
        return clean

    plain, sizes = effort({}), {}
    for name, strength in scene.hidden.items():
        size = _size(lambda s, n=name: effort({n: s}) - plain, basis, strength * noise)
        if size is None:
            return None
        sizes[name] = size
    for one in sizes:
        others = {name: size for name, size in sizes.items() if name != one}
        if _left(effort(sizes) - effort(others), basis) < LEAST * noise:
            return None  # one swallows the other, as a dead band does adhesion
    clean = effort(sizes, alone=False)
    truth = {"stiffness.k": k, "damping.c": c} if touching else dict(OF_THE_JOINT)
    if "hunt_crossley" in sizes:
        truth = {}  # it takes the place of spring and damper
    before = effort({name: size for name, size in sizes.items() if name not in FAULTS})
    scale, largest = float(np.sqrt(np.mean(before**2))), float(np.max(np.abs(before)))
    for name, size in sizes.items():
        facts = Facts(scene.kind, size, shape[name], k, c, scale, largest, motion.time_s[-1])
        truth |= of_effect(name, facts)
    data = _channel(scene, motion, clean, sizes, rng, seen_x)
    floor = float(np.sqrt(np.mean((data.effort - clean) ** 2)))
    if DRY & sizes.keys():
        seen = Motion(data.time_s, data.position, data.velocity, data.acceleration, data.run)
        floor = float(np.sqrt(np.mean((data.effort - effort(sizes, by=seen)) ** 2)))
    return Made(data, truth, floor)


def _columns(motion: Motion, touching: bool) -> np.ndarray:
    if touching:
        pressed = motion.x > 0.0
        return np.column_stack([motion.x * pressed, motion.v * pressed])
    return np.column_stack([motion.a, np.sin(motion.x), motion.v])


def _size(deviation, basis: np.ndarray, wanted: float) -> float | None:  # noqa: ANN001
    """Size at which the deviation, less what the base model mimics, has the wanted RMS."""
    sizes = np.geomspace(1e-4, 30.0, 30)
    reached = (i for i, size in enumerate(sizes) if _left(deviation(size), basis) > wanted)
    first = next(reached, 0)
    if first == 0:
        return None
    low, high = sizes[first - 1], sizes[first]
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _left(deviation(middle), basis) < wanted else (low, middle)
    return float(high)


def _left(deviation: np.ndarray, basis: np.ndarray) -> float:
    return float(np.sqrt(np.mean((deviation - basis @ (basis.T @ deviation)) ** 2)))


def _through_position(scene: Scene, motion: Motion, seen_x: np.ndarray, k: float) -> float:
    """RMS of the effort that an error of the position makes; of no account in the usual way."""
    if not scene.way:
        return 0.0
    if scene.kind is ChannelKind.CONTACT:
        missed = k * (seen_x - motion.x) * (motion.x > 0.0)
    else:
        missed = joint.INERTIA * (derived(seen_x, motion, 2) - motion.a)
        missed = missed + joint.VISCOUS * (derived(seen_x, motion, 1) - motion.v)
    return float(np.sqrt(np.mean(missed**2)))


def _channel(
    scene: Scene,
    motion: Motion,
    clean: np.ndarray,
    sizes: Mapping[str, float],
    rng: np.random.Generator,
    seen_x: np.ndarray,
) -> ChannelData:
    noise = coloured(rng, len(clean), FLOOR[scene.kind], scene.correlation)
    reading = clean + noise
    if "quantisation" in sizes:
        reading = np.round(reading / sizes["quantisation"]) * sizes["quantisation"]
    if scene.way:
        return imported(WAYS[scene.kind][scene.way], scene.kind, motion, seen_x, reading)
    seen = measured(motion, rng, *ENCODER[scene.kind])
    return ChannelData(
        name="contact" if scene.kind is ChannelKind.CONTACT else "joint_1",
        kind=scene.kind,
        time_s=seen.time_s,
        position=seen.x,
        velocity=seen.v,
        acceleration=seen.a,
        effort=reading,
        run=seen.run,
        phase=np.full(len(clean), -1),
    )


def coloured(rng: np.random.Generator, count: int, std: float, correlation: float) -> np.ndarray:
    """AR(1) noise of this standard deviation, `correlation` from one sample to the next."""
    steps = rng.normal(0.0, std * np.sqrt(1.0 - correlation**2), count + 2000)
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps))[2000:]
