"""Names from files reach CSV files as text that neither a spreadsheet nor a terminal runs."""

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from palpate.batches.table import write_table as write_batch
from palpate.export.table import write_table as write_export

CASES = {
    '=HYPERLINK("http://e","x")': '\'=HYPERLINK("http://e","x")',
    "-1+cmd|' /C calc'!A0": "'-1+cmd|' /C calc'!A0",
    "@SUM(A1)": "'@SUM(A1)",
    "\t=1+1": "' =1+1",
    "\x1b[2J\x9b31m": " [2J 31m",
    "-1.5e3": "-1.5e3",
    "+7": "+7",
    "-": "-",
    "Prüfling = 3": "Prüfling = 3",
}


@pytest.mark.parametrize("write", ["batch", "export"])
def test_text_is_no_formula_and_no_command(tmp_path, write):
    table = pa.table({"measurement": [*CASES, None], "channel": list(range(len(CASES) + 1))})
    if write == "batch":
        write_batch(tmp_path, table)
        assert pa.parquet.read_table(tmp_path / "table.parquet")["measurement"].to_pylist() == [*CASES, None]
    else:
        write_export(table, tmp_path / "table.csv")
    as_text = pa.csv.ConvertOptions(column_types={"measurement": pa.string()}, strings_can_be_null=True)
    cells = pa.csv.read_csv(tmp_path / "table.csv", convert_options=as_text)["measurement"].to_pylist()
    assert [cell or None for cell in cells] == [*CASES.values(), None]


def test_names_of_columns_and_dictionaries_of_text_are_harmless_too(tmp_path):
    table = pa.table(
        {"=1+1": pa.array(["=2+2", "a"]).dictionary_encode(), "b": pa.array(["@S", "c"], pa.large_string())}
    )
    write_export(table, tmp_path / "table.csv")
    lines = (tmp_path / "table.csv").read_text(encoding="utf-8").replace('"', "").splitlines()
    assert lines == ["'=1+1,b", "'=2+2,'@S", "a,c"]
