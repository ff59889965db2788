"""Writes docs/reference/fault-matrix.md: `.venv/bin/python docs/make_fault_matrix.py`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the tests are no installed package

from tests.wire.fault_matrix.document import DOCUMENT, document
from tests.wire.fault_matrix.rows import rows

DOCUMENT.write_text(document(tuple(rows())), encoding="utf-8")
