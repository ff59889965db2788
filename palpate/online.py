"""Estimates stiffness, damping and surface while the arm is probing."""

import math

import numpy as np

from control.phases import Phase
from estimation.estimator import OnlineEstimator

LEARNING_PHASES = (Phase.LOADING, Phase.HOLD)  # in the others the object may not be touched all the time
NONE_YET = (math.nan, math.nan, math.nan)
ENOUGH_SAMPLES = 30  # before them the three gains are hardly determined
GAINS = 3


class OnlineObserver:
    """Kelvin-Voigt with an unknown surface, as three gains in which the force is linear.

        F = k (s - s0) + c ds/dt = k d + c dd/dt - k (s0 - s1),   d = s - s1

    with s the tip's coordinate along the press direction, s0 the surface, and s1 the first touch's place.

    Args:
        estimator: takes one sample at a time.
    """

    def __init__(self, estimator: OnlineEstimator) -> None:
        self._estimator = estimator
        self._estimator.start(GAINS)
        self._first_touch_m: float | None = None
        self._samples = 0
        self._estimate = NONE_YET

    def __call__(self, record: np.void) -> tuple[float, float, float]:
        """Take in one tick; see `control.journal.Observer`.

        Returns:
            Stiffness [N/m], damping [N s/m], and the surface along the press direction [m].
        """
        if record["phase"] in LEARNING_PHASES:
            self._learn(record)
        return self._estimate

    def _learn(self, record: np.void) -> None:
        direction = record["press_direction_world"]
        along_m = float(record["tip_position_world_m"] @ direction)
        if self._first_touch_m is None:
            self._first_touch_m = along_m
        depth_m = along_m - self._first_touch_m
        speed_m_s = float(record["tip_velocity_world_m_s"] @ direction)
        row = np.array([depth_m, speed_m_s, 1.0])
        stiffness, damping, offset_n = self._estimator.update(row, float(record["force_n"])).tolist()
        self._samples += 1
        if self._samples >= ENOUGH_SAMPLES and stiffness > 0:
            self._estimate = (stiffness, damping, self._first_touch_m - offset_n / stiffness)
