import pytest

from palpate.estimation.estimate import rounded, with_unit


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1234.5, 3, "1230"), (-187_654.0, 3, "-188000"), (999_999.0, 3, "1000000"), (2.5e7, 3, "2.5e+07")],
)
def test_a_value_below_a_million_has_no_exponent(value, digits, text):
    assert rounded(value, digits) == text


def test_small_values_keep_their_digits():
    assert with_unit(0.00012345, "N", 4) == "0.0001234 N"
    assert rounded(123.0, 2) == "120"
