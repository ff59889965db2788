"""A derived acceleration is smoothed, as by a lag, and must not decide between a lag and a delay."""

import numpy as np
from estimation.diagnosis.search.confusion import rivals
from estimation.diagnosis.search.search import Search
from scipy.signal import savgol_filter

from estimation.channel import ChannelData, ChannelKind
from estimation.effects import EFFECTS
from tests.estimation.diagnosis.test_nameless import MODEL, lagging


def smoothed(sensor):
    """A joint at 1 kHz whose acceleration was derived over a wide window, as of a coarse encoder."""
    rng, step_s, runs = np.random.default_rng(5), 0.001, 4
    time_s = np.arange(0.0, 3.0, step_s)
    waves = rng.uniform([4.0, 9.0, 20.0], [6.0, 14.0, 30.0], (runs, 3))[:, :, None]
    size = np.array([0.5, 0.1, 0.02])[:, None]
    q, v = (size * np.sin(waves * time_s)).sum(1), (size * waves * np.cos(waves * time_s)).sum(1)
    a = -(size * waves**2 * np.sin(waves * time_s)).sum(1)
    effort = sensor(0.05 * a + 2.0 * np.sin(q) + 0.15 * v) + rng.normal(0.0, 0.003, q.shape)
    derived = savgol_filter(q, 41, 3, deriv=2, delta=step_s, axis=1)
    run = np.repeat(np.arange(runs), len(time_s))
    motion = (part.ravel() for part in (q, v, derived, effort))
    every = np.tile(time_s, runs) + 10.0 * run
    return ChannelData("joint_1", ChannelKind.REVOLUTE, every, *motion, run, np.full(run.size, -1))


def test_a_smoothed_acceleration_does_not_tell_a_lag_from_a_delay():
    data = smoothed(lambda effort: lagging(effort, 0.001, 0.004))
    effects = (EFFECTS["lag"](), EFFECTS["delay"]())
    good = np.ones(len(data), dtype=np.bool_)
    search = Search(data, MODEL, good, effects, np.random.default_rng(1), lambda what, share: None)
    found = search.screen(search.start)
    assert [candidate.effect.name for candidate in found] == ["delay", "lag"]  # though it is a lag

    def rivals_of_the_delay(by_positions):
        return rivals(
            found, "delay", search.start, 0.001, together=search.together, by_positions=by_positions
        )

    assert rivals_of_the_delay(lambda candidate: []) == []
    assert rivals_of_the_delay(search.by_positions) == ["lag"]
