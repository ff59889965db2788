"""Joints that swing at several speeds, some of which rub."""

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind

INERTIA, NOISE_NM = 0.05, 0.01


def joints(friction_nm=(0.0, 0.0), seed=0):
    """Two joints with inertia and Coulomb friction [N m], four runs each."""
    rng = np.random.default_rng(seed)
    run, t = np.repeat(np.arange(4), 300), np.tile(np.arange(300) * 0.02, 4)
    w = 2 * np.pi * (0.5 + 0.1 * run)
    q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
    return tuple(
        ChannelData(
            name=f"joint_{number}",
            kind=ChannelKind.REVOLUTE,
            time_s=t,
            position=q,
            velocity=v,
            acceleration=a,
            effort=INERTIA * a + friction * np.sign(v) + rng.normal(0.0, NOISE_NM, len(t)),
            run=run,
            phase=np.full(len(t), -1),
        )
        for number, friction in enumerate(friction_nm, 1)
    )
