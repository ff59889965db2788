"""What a diagnosis says once the study has put in the numbers of its own fits."""

import pytest

from estimation.diagnosis import ChannelDiagnosis
from estimation.diagnosis.result import Ranked
from estimation.study.reconcile import reason_of

BEST = Ranked(effect="drift", rmse_held_out=0.3, score=0.4)
NEXT = Ranked(effect="lag", rmse_held_out=0.45, score=0.1)
NOTHING = Ranked(effect="lag", rmse_held_out=0.5, score=0.001)


@pytest.mark.parametrize(
    ("verdict", "ranking", "added"),
    [
        ("unexplained", [BEST, NEXT], "; the best single effect, drift, takes away 40 % of the error"),
        ("unexplained", [NOTHING], ""),
        ("unexplained", [], ""),
        ("missing", [BEST], ""),
        ("adequate", [BEST], ""),
    ],
)
def test_where_nothing_is_established_the_best_single_effect_is_named_with_what_it_takes(
    verdict, ranking, added
):
    found = ChannelDiagnosis(channel="contact", verdict=verdict, reason="why", effort_unit="N")
    reason = reason_of(found, ranking)
    assert reason.startswith(f"why{added}")
    assert bool(added) == (reason != "why")
