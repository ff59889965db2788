"""Where the tables in a text begin and end, however its lines do."""

import numpy as np
import pytest

from estimation.data.table import read_table
from robot_io.errors import InputError

HEAD = "Time [s],Travel [mm],Load [N]"
ROWS = [f"{i / 8},{i},{2 * i}" for i in range(9)]


@pytest.fixture
def read(tmp_path):
    """Writes a text and reads it."""

    def reader(text):
        path = tmp_path / "tests.csv"
        path.write_bytes(text.encode())
        return read_table(path)

    return reader


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("footer", [[], ["", ",,", "Mean,7"]])
def test_lines_may_end_in_any_way(read, end, footer):
    table = read(end.join([HEAD, *ROWS, "", HEAD, *ROWS, *footer, ""]))
    np.testing.assert_array_equal(table.numbers("Load [N]"), np.tile(2.0 * np.arange(9), 2))
    assert len(table.labels("run")[0]) == 2
    assert ("a footer of 2 lines" in table.words) is bool(footer)


@pytest.mark.parametrize("behind", ["\r\n", " \n", "\t \r\n"])
def test_a_header_is_the_same_with_blanks_behind_it(read, behind):
    table = read("\n".join([HEAD, *ROWS, HEAD]) + behind + "\n".join(ROWS))
    assert len(table.labels("run")[0]) == 2
    assert len(table) == 18


def test_words_below_a_header_are_named_as_what_they_are(read):
    with pytest.raises(InputError, match="line 2, column 'force_N': 'c' is no finite number"):
        read("time_s,displacement_m,force_N\na,b,c\n").numbers("force_N")


@pytest.mark.parametrize("cut", ["5.99,,", "5.99,", ",1,"])
def test_a_row_that_lacks_its_last_numbers_is_no_footer(read, cut):
    with pytest.raises(InputError, match="line 11"):
        read("\n".join([HEAD, *ROWS, cut])).numbers("Load [N]")
