"""Write tables as CSV or Parquet files.

Spreadsheets and terminals would run some text of a CSV file as formulas or commands; it is made harmless.
"""

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from palpate.common.files import atomic_write
from palpate.robot_io.errors import one_line

_CONTROLS = r"[\x00-\x1f\x7f\x80-\x9f]"
_FORMULA = r"^\s*[=+@-]."
_NUMBER = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
NOTES = "notes"  # key of a table's metadata: lines that a CSV file begins with, after "# "


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table, completely or not at all.

    Args:
        table: table to write.
        path: a Parquet file if it ends in .parquet, otherwise a CSV file.

    Raises:
        InputError: the file cannot be written.
    """
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:  # Arrow takes no name but UTF-8
        if path.suffix == ".parquet":
            pa.parquet.write_table(table, file)
            return
        for place, column in enumerate(table.columns):
            kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
            if pa.types.is_string(kind) or pa.types.is_large_string(kind):
                text = _harmless(column.cast(pa.string()))
                table = table.set_column(place, table.column_names[place], text)
        names = _harmless(pa.array(table.column_names, pa.string())).to_pylist()
        for line in (table.schema.metadata or {}).get(NOTES.encode(), b"").decode().splitlines():
            file.write(f"# {one_line(line)}\n".encode())
        pa.csv.write_csv(table.rename_columns(names), file)


def _harmless(text: pa.Array | pa.ChunkedArray) -> pa.Array | pa.ChunkedArray:
    """Replace control characters by blanks, and put an apostrophe before what would be a formula."""
    line = pc.replace_substring_regex(text, _CONTROLS, " ")
    is_number = pc.match_substring_regex(line, _NUMBER)
    is_formula = pc.and_not(pc.match_substring_regex(line, _FORMULA), is_number)
    return pc.if_else(is_formula, pc.binary_join_element_wise("'", line, ""), line)
