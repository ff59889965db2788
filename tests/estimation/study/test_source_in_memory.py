"""Measurements in memory that a study refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.study.source import limit_length, open_source
from palpate.robot_io.errors import InputError

T = np.arange(200) * 0.01
COLUMNS = {"time_s": T, "displacement_m": 0.01 * np.sin(T), "force_N": 5.0 * np.sin(T) + 0.5 * np.cos(T)}


def test_duplicate_channel_names_are_refused():
    (one,) = open_source(COLUMNS).channels
    with pytest.raises(InputError, match="several channels are called contact"):
        open_source([one, one])


N = len(T)


@pytest.mark.parametrize(
    ("force", "said"),
    [
        (np.ones((N, 2)), r"column 'force_N' has shape \(200, 2\), expected one value per row"),
        (3.0, r"column 'force_N' has shape \(\), expected one value per row"),
        (np.ones(N - 1), "different lengths: time_s 200, displacement_m 200, force_N 199"),
        (np.ones(N) * 1j, "column 'force_N' holds complex numbers"),
        ([object()] * N, "column 'force_N' holds values of type object"),
        (["much"] * N, "holds no numbers at all; name another column with --column"),
        (T.astype("datetime64[s]"), "column 'force_N' holds clock times instead of force"),
        ([f"00:00:{t:05.2f}" for t in T], "column 'force_N' holds clock times instead of force"),
        ([*T.tolist()[:-1], [1.0, 2.0]], "column 'force_N' holds values of type float, list"),
    ],
)
def test_nonnumeric_column_is_named(force, said):
    with pytest.raises(InputError, match=said):
        open_source({**COLUMNS, "force_N": force})


@pytest.mark.parametrize("kind", [">f8", ">f4", np.longdouble])
def test_numbers_of_other_byte_orders_and_lengths_are_read(kind):
    (channel,) = open_source({**COLUMNS, "force_N": COLUMNS["force_N"].astype(kind)}).channels
    np.testing.assert_allclose(channel.effort, COLUMNS["force_N"], rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": "<b>"}, "channel name '<b>': give letters"),
        ({"name": 5}, "channel name 5: give letters"),
        ({"kind": "x"}, "kind 'x' is not known. Valid: contact, revolute"),
        ({"time_s": -T}, r"time_s -0.01 of sample 1 does not come after -?0; times must increase"),
        ({"position": np.ones((N, 1))}, r"position has shape \(200, 1\), expected one value per sample"),
        ({"run": np.full(N, 0.5)}, "run holds float64, expected integers"),
        ({"run": np.repeat([0, 1, 0, 1], N // 4)}, "run 0 continues at sample 100, after another run"),
        ({"phase": np.full(N, 99)}, "there is no phase 99. Valid: -1 to 8"),
    ],
)
def test_invalid_channels_are_refused(change, said):
    (channel,) = open_source(COLUMNS).channels
    with pytest.raises(InputError, match=said):
        open_source(replace(channel, **change))


@pytest.mark.parametrize("held_out", [0, ["0", 7], [[0]]])
def test_held_out_runs_are_a_list_of_numbers(held_out):
    with pytest.raises(InputError, match=re.escape(f"held_out={held_out!r}: give a list of run numbers")):
        limit_length(open_source(COLUMNS), held_out)


def test_masked_readings_are_left_out():
    force = np.ma.masked_greater(COLUMNS["force_N"], 4.9)
    (channel,) = open_source({**COLUMNS, "force_N": force}).channels
    assert np.array_equal(channel.effort, force.compressed())
    assert np.array_equal(channel.time_s, T[~force.mask])


def test_columns_that_make_no_channel_are_named():
    with pytest.raises(InputError, match="no channel can be made of columns time_s, other"):
        open_source({"time_s": [0.0, 1.0], "other": [0.0, 1.0]})
    with pytest.raises(InputError, match="no rows"):
        open_source({"time_s": []})


@pytest.mark.parametrize("data", [3, None, {}, [], np.ones((10, 3))])
def test_error_for_unsupported_data_lists_the_supported_types(data):
    with pytest.raises(InputError, match=f"data of type {type(data).__name__}.*a table"):
        open_source(data)


@pytest.mark.parametrize(
    "options",
    [
        {"columns": ["force_N"]},
        {"columns": {"force_N": 3}},
        {"units": "mN"},
        {"where": {"run": 1}},
        {"context": "temperature"},
        {"context": (3,)},
        {"fresh": "no"},
    ],
)
def test_options_of_another_type_are_refused_by_name(options):
    with pytest.raises(InputError, match=f"{next(iter(options))}=.*: give"):
        ImportOptions(**options)


@pytest.mark.parametrize(
    ("changed", "note"),
    [
        ({}, ""),
        ({"time_s": 1000 * T}, "samples are 10 s apart; .* --unit time=ms"),
        ({"time_s": T / 1e4}, "samples are 1e-06 s apart; .* --unit time=h"),
        ({"weekday": np.repeat([3, 1], N // 2)}, "'weekday' looks like a run number; .* run=weekday"),
        ({"trial": np.repeat([3, 1], N // 2)}, ""),  # which it says by its name
        ({"count": np.arange(N)}, ""),
        ({"level": 0.5 + np.repeat([3, 1], N // 2)}, ""),
    ],
)
def test_likely_mistakes_are_noted(changed, note):
    notes = " ".join(open_source(COLUMNS | changed).notes)
    assert re.search(note, notes) if note else not notes
