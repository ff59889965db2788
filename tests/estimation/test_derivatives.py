import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from palpate.estimation.data import derivatives
from palpate.estimation.data.derivatives import (
    _fits_by_piece,
    _pilot_window,
    _WindowFit,
    differentiate,
    grid_step,
    local_derivative,
    local_fits,
    uneven_derivative_operator,
)
from palpate.estimation.signals.blocks import number_pieces
from palpate.estimation.signals.local_polynomials import fit_weights

ONE_PIECE = lambda t: np.zeros(len(t), dtype=np.int64)  # noqa: E731


def local_fit(time_s, position, centers, half):
    """Fits around samples of one piece."""
    return _fits_by_piece(time_s, position, [slice(0, len(time_s))], [centers], half)


@given(
    st.lists(st.floats(-2, 2), min_size=4, max_size=4),
    st.lists(st.floats(0.2, 3.0), min_size=12, max_size=40),
    st.integers(2, 6),
)
def test_cubics_are_exact_at_any_sampling(coefficients, steps, half_window):
    t = np.cumsum(steps) * 0.01
    cubic = np.polynomial.Polynomial(coefficients)
    found = differentiate(t, cubic(t), ONE_PIECE(t), half_window)
    scale = 1 + np.abs(coefficients).max()
    np.testing.assert_allclose(found.velocity, cubic.deriv()(t), atol=1e-6 * scale)
    np.testing.assert_allclose(found.acceleration, cubic.deriv(2)(t), atol=1e-4 * scale)


@pytest.mark.parametrize(
    ("count", "half_window"),  # long pieces are fitted part by part
    [(200, 3), (200, 8), (20_000, 8), (20_001, 8), (20_007, 8), (45_000, 8)],
)
def test_even_sampling_matches_savitzky_golay(count, half_window):
    t = np.arange(count) * 0.002
    x = np.random.default_rng(0).standard_normal(count)
    found = differentiate(t, x, ONE_PIECE(t), half_window)
    width = 2 * half_window + 1
    for order, values in ((1, found.velocity), (2, found.acceleration)):
        expected = savgol_filter(x, width, 3, deriv=order, delta=0.002)
        np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_kink_between_two_pieces_stays_sharp():
    t = np.arange(400) * 1e-3
    x = np.where(t < 0.2, 0.1 * t, 0.02 + 0.9 * (t - 0.2))
    apart = differentiate(t, x, (t >= 0.2).astype(np.int64), 10).velocity
    together = differentiate(t, x, ONE_PIECE(t), 10).velocity
    np.testing.assert_allclose(apart, np.where(t < 0.2, 0.1, 0.9), atol=1e-6)
    assert np.abs(together - np.where(t < 0.2, 0.1, 0.9)).max() > 0.1


@pytest.mark.parametrize("noise", [1e-7, 5e-5])
@pytest.mark.parametrize("rate", [5.0, 15.0, 60.0])
def test_chosen_window_is_nearly_optimal(rate, noise):
    """Neither for velocity nor for acceleration, each with a window of its own."""
    t = np.arange(4000) * 1e-3
    x = 0.05 / rate * np.sin(rate * t)
    v, a = 0.05 * np.cos(rate * t), -0.05 * rate * np.sin(rate * t)
    noisy = x + noise * np.random.default_rng(5).standard_normal(len(t))
    found = differentiate(t, noisy, ONE_PIECE(t))
    others = [differentiate(t, noisy, ONE_PIECE(t), half) for half in (2, 3, 4, 5, 7, 10, 14, 20, 28)]
    assert np.std(found.velocity - v) < 1.25 * min(np.std(other.velocity - v) for other in others)
    assert np.std(found.acceleration - a) < 1.25 * min(np.std(other.acceleration - a) for other in others)


def test_fit_with_repeated_times_stays_within_its_samples():
    t = np.repeat(np.arange(12) * 0.01, 4)
    x = np.tile([-1.0, 1.0, -2.0, 2.0], 12) + 3.0 * t
    fitted = local_fit(t, x, np.arange(len(t)), 3).fitted
    assert np.isfinite(fitted).all()
    assert np.max(np.abs(fitted[:, 0] - 3.0 * t)) <= 2.0 + 1e-9


@pytest.mark.parametrize("steps", [np.full(30, 0.01), np.linspace(0.008, 0.012, 30)])
def test_fit_reports_its_noise_gain(steps):
    t, centers = np.cumsum(steps), np.array([0, 3, 15, 29])
    rng = np.random.default_rng(6)
    draws = [local_fit(t, rng.standard_normal(30), centers, 6).fitted for _ in range(3000)]
    expected = local_fit(t, np.zeros(30), centers, 6).variance
    np.testing.assert_allclose(np.var(draws, axis=0), expected, rtol=0.12)


@pytest.mark.parametrize("turns_hz", [1.0, 3.0])
@pytest.mark.parametrize("noise", [1e-6, 4e-6])
def test_narrow_windows_are_as_good_before_averaging(turns_hz, noise):
    """Means over 10 ms, of an acceleration that changes as quickly as that of a probing arm does."""
    t = np.arange(4000) * 1e-3
    jumping = np.where(np.sin(2 * np.pi * turns_hz * t) > 0.0, 4.0, -4.0)
    true = np.convolve(jumping, np.ones(8) / 8.0, "same")
    x = np.cumsum(np.cumsum(true)) * 1e-6 + noise * np.random.default_rng(5).standard_normal(len(t))
    chosen = [
        differentiate(t, x, ONE_PIECE(t), rounding=0.0, prefer_wide=prefer_wide)
        for prefer_wide in (True, False)
    ]
    errors = [np.std((c.acceleration - true)[100:-100].reshape(-1, 10).mean(axis=1)) for c in chosen]
    assert errors[1] <= errors[0]
    if (turns_hz, noise) == (3.0, 4e-6):
        assert errors[1] < 0.9 * errors[0]


@pytest.mark.parametrize("steps", [[7e-5], [3e-5, 7e-5]], ids=["one encoder", "two in a row"])
def test_encoder_steps_do_not_narrow_the_window(steps):
    """Within a step neighbours share one error, which narrow windows would predict perfectly."""
    t = np.arange(4000) * 1e-3
    moving = np.clip(t - 1.0, 0.0, 0.5)
    x = 0.04 * (moving - np.sin(4 * np.pi * moving) / (4 * np.pi)) + 3e-5 * np.sin(5 * t)
    true = 0.04 * (1 - np.cos(4 * np.pi * moving)) + 15e-5 * np.cos(5 * t)
    shares = np.linspace(1.0, 2.0, len(steps)) / np.linspace(1.0, 2.0, len(steps)).sum()
    seen = sum(np.round(share * x / step) * step for share, step in zip(shares, steps, strict=True))
    found = differentiate(t, seen, ONE_PIECE(t))
    others = [differentiate(t, seen, ONE_PIECE(t), half) for half in (2, 3, 4, 5, 7, 10, 14, 20, 28)]
    assert np.std(found.velocity - true) < 1.25 * min(np.std(other.velocity - true) for other in others)


@pytest.mark.parametrize("rate_hz", [80.0, 120.0])
def test_joint_held_between_two_counts_does_not_narrow_the_window(rate_hz):
    t, step = np.arange(4000) * 1e-3, 2 * np.pi / 4096  # an encoder of 12 bits
    goals = (np.array([0, 0, 400, 130, 330]) + 0.5) * step
    x = np.convolve(np.repeat(goals, 1000), np.hanning(300) / np.hanning(300).sum())[1000:5000]
    trembling = x + 0.2 * step * np.sin(2 * np.pi * rate_hz * t)
    velocity = [
        differentiate(t, np.round(seen / step) * step, ONE_PIECE(t)).velocity for seen in (x, trembling)
    ]
    true = np.gradient(x, t)
    assert np.std(velocity[1] - true) < 1.5 * np.std(velocity[0] - true)


@pytest.mark.parametrize(("missed", "half"), [(0.9, 10), (1.1, 3)])
def test_windows_below_rounding_follow_steps_without_bending_the_motion(missed, half):
    """The velocity changes least between 4 and 5, then between 14 and 20; 4 to 7 is the wider step."""
    velocity = np.cumsum([0.0, 12.0, 7.0, 3.8, 4.8, 3.2, 1.9, 1.1, 1.5])
    windows = zip((2, 3, 4, 5, 7, 10, 14, 20, 28), velocity, strict=True)
    trials = [
        _WindowFit(one, 1.0, np.full(8, missed), np.full((8, 3), found), np.zeros((8, 3)))
        for one, found in windows
    ]
    assert _pilot_window(trials).half == half


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_short_pieces_get_a_lower_order_fit(count):
    t = 0.1 * np.arange(count)
    found = differentiate(t, 3 * t, ONE_PIECE(t))
    np.testing.assert_allclose(found.velocity, 3.0 if count > 1 else 0.0, atol=1e-9)
    np.testing.assert_allclose(found.acceleration, 0.0, atol=1e-6)


def test_center_slope_is_in_the_middle_and_pieces_end_at_runs_and_gaps():
    steps = np.arange(11.0)
    assert fit_weights(11, 1)[5] @ (steps**2) == pytest.approx(10.0)
    time_s = np.array([0, 1, 2, 3, 7, 8, 0, 1, 2], float)
    run = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(number_pieces(time_s, run), [0, 0, 0, 0, 1, 1, 2, 2, 2])


def test_falling_sample_rate_makes_no_gaps():
    """As of a tension test that records yielding at 12 Hz and what follows at 2 Hz."""
    time_s = np.cumsum(np.repeat([0.08, 0.4, 0.08], [300, 150, 300]))
    piece = number_pieces(time_s, np.zeros(len(time_s), dtype=np.int64))
    assert len(np.unique(piece)) == 1
    moved = differentiate(time_s, 2e-5 * time_s, piece)
    np.testing.assert_allclose(moved.velocity, 2e-5, rtol=1e-6)


@pytest.mark.parametrize("place", [0.01, 1e6 / 3])
def test_resting_object_does_not_drift_by_rounding(place):
    time_s, piece = np.arange(200) * 0.002, np.repeat([0, 1], 100)
    found = differentiate(time_s, np.full(200, place), piece)
    assert not found.velocity.any()
    assert not found.acceleration.any()


def test_smooth_stretches_do_not_choose_the_window_of_others():
    """A long calm swing before a short sharp motion, each with the same noise."""
    t = np.arange(0.0, 8.0, 0.001)
    sharp = t > 7.0
    position = np.sin(2.0 * t) + np.where(sharp, 0.004 * (1.0 - np.cos(120.0 * (t - 7.0))), 0.0)
    position += np.random.default_rng(3).normal(0.0, 1e-5, len(t))
    truth = -4.0 * np.sin(2.0 * t) + np.where(sharp, 57.6 * np.cos(120.0 * (t - 7.0)), 0.0)
    inside = slice(7100, 7900)

    def missed(tried):
        found = differentiate(t, position, ONE_PIECE(t), prefer_wide=False, window_rows=tried)
        averaged = (found.acceleration - truth)[inside].reshape(-1, 10).mean(axis=1)
        return found.half_windows[1], np.std(averaged)

    wide, cut = missed(None)
    narrow, kept = missed(sharp)
    assert narrow < wide
    assert kept < 0.8 * cut


@pytest.mark.parametrize("half", [2, 7, 40])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("count", [60, 300])
def test_single_derivative_equals_fits_around_all_samples(half, order, count):
    rng = np.random.default_rng(count)
    signal = np.cumsum(rng.standard_normal(count))
    for time_s in (0.002 * np.arange(count), np.cumsum(rng.uniform(0.001, 0.003, count))):
        whole = local_fit(time_s, signal, np.arange(count), half).fitted[:, order]
        alone = local_derivative(time_s, signal, half, order)
        np.testing.assert_allclose(alone, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


def test_long_motion_is_differentiated_in_groups_as_at_once(monkeypatch):
    rng, lengths = np.random.default_rng(1), (23_000, 7_000, 41_000, 900)
    piece = np.repeat(np.arange(len(lengths)), lengths)
    time_s = 0.001 * np.arange(len(piece)) + rng.uniform(0.0, 2e-4, len(piece))
    position = np.sin(40.0 * time_s) + 1e-5 * rng.normal(size=len(piece))
    at_once = differentiate(time_s, position, piece)
    monkeypatch.setattr(derivatives, "_IN_MEMORY", 20_000)
    in_groups = differentiate(time_s, position, piece)
    assert len(set(in_groups.half_windows)) == 2  # velocity and acceleration have windows of their own
    for name in ("position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(in_groups, name), getattr(at_once, name))


def test_encoder_step_is_detected_after_zero_subtraction():
    step, counts = 2.0 * np.pi / 4096, np.cumsum(np.random.default_rng(3).integers(-2, 3, 2000))
    ways = counts * step + 0.7, (counts + 1000) * step + (0.7 - 1000 * step)  # alike but for rounding
    position = np.where(np.arange(len(counts)) % 2 == 0, *ways)
    assert np.any(np.diff(position)[np.diff(counts) == 0] != 0.0)
    assert grid_step(position) == pytest.approx(step, rel=1e-9)
    assert grid_step(position + 0.2 * step * np.random.default_rng(4).standard_normal(2000)) == 0.0


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("counts", [(1,), (2,), (5,), (200,), (9, 1, 3, 200, 2, 9, 4, 40)])
def test_operator_derives_a_signal_like_local_fits_of_each_piece(order, counts):
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, sum(counts)))
    signal, ends = rng.standard_normal(len(time_s)), np.cumsum(counts).tolist()
    pieces = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    expected = np.concatenate(
        [
            local_fit(time_s[rows], signal[rows], np.arange(rows.stop - rows.start), 4).fitted[:, order]
            for rows in pieces
        ]
    )
    found = uneven_derivative_operator(time_s, pieces, 4, order) @ signal
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * (1.0 + np.abs(expected).max()))


def test_pieces_of_uneven_samples_are_fitted_at_once_as_alone():
    rng = np.random.default_rng(2)
    counts = (40, 3, 7, 300, 5, 12, 7)
    time_s = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, sum(counts)))
    time_s[50:350] = time_s[50] + 1e-3 * np.arange(300)  # one of them is even
    time_s[350:] += 1.0
    position, ends = rng.standard_normal(len(time_s)), np.cumsum(counts).tolist()
    pieces = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    centers = [np.arange(0, count, 2) for count in counts]
    together = local_fits(time_s, position, pieces, centers, 5)
    polynomials = []
    for rows, chosen in zip(pieces, centers, strict=True):
        for center in chosen:
            start = min(max(center - 5, 0), max(rows.stop - rows.start - 11, 0))
            window = slice(rows.start + start, min(rows.start + start + 11, rows.stop))
            away = time_s[window] - time_s[rows.start + center]
            fitted = (
                np.polynomial.Polynomial.fit(away, position[window], min(3, len(away) - 1)).convert().coef
            )
            polynomials.append(fitted[:3] * (1.0, 1.0, 2.0))
    scale = np.abs(polynomials).max(axis=0)
    np.testing.assert_allclose(together.fitted / scale, polynomials / scale, atol=1e-9)
