"""What a study refuses of measurements in memory."""

import numpy as np
import pytest

from estimation.study.source import open_source
from robot_io.errors import InputError

T = np.arange(200) * 0.01
COLUMNS = {"time_s": T, "displacement_m": 0.01 * np.sin(T), "force_N": 5.0 * np.sin(T)}


def test_channels_of_one_name_are_refused():
    (one,) = open_source(COLUMNS).channels
    with pytest.raises(InputError, match="several channels are called contact"):
        open_source([one, one])


def test_what_is_masked_is_no_number():
    masked = np.ma.masked_greater(COLUMNS["force_N"], 4.0)
    with pytest.raises(InputError, match="no finite number"):
        open_source({**COLUMNS, "force_N": masked})
