"""Damaged and hostile files, kind by kind; see `fuzz_files.py`."""
