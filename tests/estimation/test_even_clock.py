"""Rows of an even sampler that were stamped in packets or by a coarse clock, and uneven samples."""

import numpy as np
import pytest

from palpate.estimation.data.even_clock import note_uneven, spread_packets
from palpate.estimation.data.import_file import import_file
from tests.files import write_csv

STEP_S = 0.005
TIME_S = STEP_S * np.arange(2400)
RUN = np.arange(2400) // 600


def swing(time_s):
    return np.sin(2.0 * time_s) + 0.3 * np.sin(5.1 * time_s)


def in_packets(sizes, within_s, late_s=0.0):
    """Stamp each packet on its arrival, which is late by up to `late_s`."""
    random, stamps, start = np.random.default_rng(1), TIME_S.copy(), 0
    for size in sizes:
        rows = slice(start, min(start + size, len(stamps)))
        count = rows.stop - rows.start
        if count > 0:
            arrival_s = TIME_S[rows.stop - 1] + late_s * random.random()
            stamps[rows] = arrival_s + within_s * np.arange(count) * random.uniform(0.5, 1.0, count)
        start += size
    return np.maximum.accumulate(stamps) + 1e-9 * np.arange(len(stamps))


@pytest.mark.parametrize("run", [RUN, np.zeros_like(RUN)])
@pytest.mark.parametrize(
    "stamped_s",
    [
        *[in_packets([size] * 1200, 2e-5) for size in (2, 3, 8, 40)],
        in_packets(np.random.default_rng(2).integers(1, 40, 400), 2e-5),
        in_packets([8] * 300, 2e-5, late_s=0.02),
        *[np.floor(TIME_S / clock_s + 1e-9) * clock_s for clock_s in (0.006, 0.016, 0.05)],
    ],
)
def test_rows_of_an_even_sampler_get_its_clock(stamped_s, run):
    noisy = swing(TIME_S) + 0.02 * np.random.default_rng(0).standard_normal(len(TIME_S))
    spread_s = spread_packets(stamped_s, run, noisy[None])
    np.testing.assert_allclose(np.diff(spread_s)[np.diff(run) == 0], STEP_S, rtol=0.02)
    assert note_uneven(spread_s, run, noisy[None]) == ""


RANDOM = np.random.default_rng(3)
INDEX = np.arange(2400)


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize(
    "time_s",
    [
        np.cumsum(RANDOM.exponential(STEP_S, 2400)),
        STEP_S * (INDEX + RANDOM.uniform(-0.45, 0.45, 2400)),
        np.cumsum(STEP_S * 10.0 ** (np.sin(0.05 * INDEX) * RANDOM.uniform(0.3, 1.5, 2400))),
        0.05 * (INDEX // 10) + 0.001 * (INDEX % 10),  # bursts of ten
        0.01 * (INDEX // 2) + 0.001 * (INDEX % 2),
        np.cumsum(np.where(INDEX < 1200, 0.001, 0.02)),
        STEP_S * INDEX + 0.7 * (INDEX // 50),  # pauses
        TIME_S,
    ],
)
def test_uneven_samples_keep_their_times(time_s, noise):
    position = swing(time_s) + noise * RANDOM.standard_normal(len(time_s))
    np.testing.assert_array_equal(spread_packets(time_s, RUN, position[None]), time_s)
    assert note_uneven(time_s, RUN, position[None]) == ""


@pytest.mark.parametrize("late_s", [0.0, 1.0])
def test_packets_are_spread_or_reported(tmp_path, late_s):
    """If their arrival follows no even clock, the times stay as they are."""
    stamped_s = in_packets([8] * 300, 2e-5, late_s)
    columns = np.c_[stamped_s, swing(TIME_S), np.cos(2.0 * TIME_S)]
    names = ("time_s", "position_rad", "torque_Nm")
    path = write_csv(tmp_path / "packets.csv", dict(zip(names, columns.T, strict=True)))
    imported = import_file(path)
    (channel,) = imported.channels
    if late_s:
        np.testing.assert_allclose(channel.time_s, stamped_s, atol=1e-9)
        assert any("the times of 'time_s' are uneven" in warning for warning in channel.import_warnings)
    else:
        np.testing.assert_allclose(np.diff(channel.time_s), STEP_S, rtol=1e-4)
        assert any("stamps rows in packets" in note for note in imported.notes)


def test_long_burst_after_a_gap_is_spread(tmp_path):
    stamped_s = TIME_S.copy()
    stamped_s[700:760] = TIME_S[759] + 1e-5 * np.arange(60)
    columns = {"time_s": stamped_s, "position_rad": swing(TIME_S), "torque_Nm": np.cos(2.0 * TIME_S)}
    (channel,) = import_file(write_csv(tmp_path / "burst.csv", columns)).channels
    np.testing.assert_allclose(channel.time_s, TIME_S, atol=1e-3)
