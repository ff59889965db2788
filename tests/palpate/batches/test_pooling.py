"""Random effects, corrected tests and outliers, against independent references and known truths."""

import warnings

import numpy as np
import pytest
from scipy.stats import t, ttest_ind

from palpate.batches.pooling import PooledParameter, group_differences, outliers, shared_parameters
from palpate.batches.statistics import holm, random_effects, shrunk
from palpate.batches.table import ParameterColumn


def column(values, std_errs):
    rows = np.arange(len(values))
    return ParameterColumn("contact", "stiffness.k", "N/m", rows, np.array(values), np.array(std_errs))


@pytest.mark.parametrize("spread", [0.0, 0.5, 3.0, 40.0])
def test_mean_and_spread_match_statsmodels(spread):
    from statsmodels.stats.meta_analysis import combine_effects  # slow to import

    rng = np.random.default_rng(3)
    std_errs = rng.uniform(0.5, 4.0, 25)
    values = 100.0 + spread * rng.standard_normal(25) + std_errs * rng.standard_normal(25)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reference = combine_effects(values, std_errs**2, method_re="iterated", atol=1e-12)
    found = random_effects(values, std_errs)
    assert found.spread**2 == pytest.approx(max(reference.tau2, 0.0), rel=1e-6, abs=1e-9)
    assert found.mean == pytest.approx(reference.mean_effect_re, rel=1e-9)
    assert found.std_err == pytest.approx(reference.sd_eff_w_re, rel=1e-6)


@pytest.mark.parametrize("number", [3, 8, 30])
def test_intervals_have_their_nominal_coverage(number):
    rng = np.random.default_rng(5)
    held = predicted = 0
    for _ in range(600):
        std_errs = rng.uniform(0.05, 0.3, number) * (10.0 if number > 3 else 1.0)
        values = 50.0 + 2.0 * rng.standard_normal(number) + std_errs * rng.standard_normal(number)
        found = random_effects(values, std_errs)
        held += found.interval[0] <= 50.0 <= found.interval[1]
        predicted += found.prediction[0] <= 50.0 + 2.0 * rng.standard_normal() <= found.prediction[1]
    assert 0.92 <= held / 600 <= 0.98
    assert 0.92 <= predicted / 600 <= 0.98


@pytest.mark.parametrize("unit", [1.0, 1e-12])
def test_prediction_from_exact_values_is_student_s_interval(unit):
    values = unit * np.array([1.0, 2.0, 4.0])
    half = t.ppf(0.975, 2) * values.std(ddof=1) * np.sqrt(1.0 + 1.0 / 3.0)
    expected = values.mean() - half, values.mean() + half
    assert random_effects(values, np.zeros(3)).prediction == pytest.approx(expected, rel=1e-3, abs=0.0)


@pytest.mark.parametrize("number", [3, 5, 10])
def test_interval_covers_if_only_some_values_are_precise(number):
    rng = np.random.default_rng(6)
    held = 0
    for _ in range(600):
        std_errs = rng.choice([0.1, 5.0], number)
        found = random_effects(400.0 + np.hypot(1.0, std_errs) * rng.standard_normal(number), std_errs)
        held += found.interval[0] <= 400.0 <= found.interval[1]
    assert 0.92 <= held / 600 <= 0.98


def test_partial_pooling_is_nearer_to_the_truth_than_single_values():
    rng = np.random.default_rng(7)
    truth = 100.0 + 3.0 * rng.standard_normal(40)
    std_errs = rng.uniform(1.0, 12.0, 40)
    values = truth + std_errs * rng.standard_normal(40)
    drawn = shrunk(values, std_errs, random_effects(values, std_errs))
    assert np.sqrt(np.mean((drawn - truth) ** 2)) < 0.7 * np.sqrt(np.mean((values - truth) ** 2))
    exact = random_effects(values, np.zeros(40))
    assert shrunk(values, np.zeros(40), exact) == pytest.approx(values)


@pytest.mark.parametrize("values", [[5.0], [5.0, 5.0, 5.0], [0.0, 0.0]])
def test_equal_values_and_a_single_one_have_no_spread(values):
    found = random_effects(np.array(values), np.zeros(len(values)))
    assert found.mean == values[0]
    assert found.spread == pytest.approx(0.0, abs=1e-6)


def test_two_group_test_equals_welch_for_exact_values():
    rng = np.random.default_rng(1)
    first, second = rng.normal(10, 1, 9), rng.normal(12, 3, 14)
    pooled = [
        PooledParameter(
            "contact", "stiffness.k", "N/m", name, random_effects(values, np.full(len(values), 1e-6))
        )
        for name, values in (("a", first), ("b", second))
    ]
    (difference,) = group_differences(pooled)
    reference = ttest_ind(second, first, equal_var=False)
    assert difference.difference == pytest.approx(second.mean() - first.mean())
    assert difference.p_value == pytest.approx(reference.pvalue, rel=1e-6)
    assert difference.interval == pytest.approx(tuple(reference.confidence_interval()), rel=1e-6)


def test_corrected_p_values_match_statsmodels():
    from statsmodels.stats.multitest import multipletests  # slow to import

    p_values = [0.04, 0.001, 0.5, 0.012, 0.012, 0.9]
    assert holm(p_values) == pytest.approx(multipletests(p_values, method="holm")[1])
    assert holm([]) == []


def test_outlier_is_named_and_an_uncertain_value_is_not():
    values = np.array([99.0, 101.0, 100.0, 98.0, 102.0, 100.5, 160.0, 160.0])
    std_errs = np.array([0.5] * 7 + [50.0])
    (outlier,) = outliers(column(values, std_errs), ["all"] * 8)
    assert (outlier.row, outlier.value) == (6, 160.0)
    assert outliers(column(values[5:], std_errs[5:]), ["all"] * 3) == []


@pytest.mark.parametrize("number", [5, 6, 10, 50, 300])
def test_clean_group_has_an_outlier_at_the_stated_rate(number):
    rng = np.random.default_rng(12)
    groups = [column(rng.normal(400.0, 5.0, number), np.zeros(number)) for _ in range(1_000)]
    assert 3 <= sum(bool(outliers(group, ["all"] * number)) for group in groups) <= 20  # 10 expected


def test_shared_value_is_within_its_interval_unless_estimates_differ():
    rng = np.random.default_rng(11)
    held, refused, noticed = 0, 0, 0
    for _ in range(400):
        std_errs = rng.uniform(0.5, 2.0, 12)
        values = 100.0 + std_errs * rng.standard_normal(12)
        (same,) = shared_parameters([column(values, std_errs)], ["all"] * 12, ["stiffness"])
        refused += same.contradicted
        held += same.contradicted or same.interval[0] < 100.0 < same.interval[1]
        (unlike,) = shared_parameters(
            [column(values + 5.0 * (np.arange(12) < 6), std_errs)], ["all"] * 12, ["stiffness"]
        )
        noticed += unlike.contradicted
        assert np.isnan(unlike.value) == unlike.contradicted
    assert 0.92 < held / 400 < 0.98
    assert refused <= 12  # 4 expected
    assert noticed >= 390
