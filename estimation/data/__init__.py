"""Channels from sessions and from data files."""

from estimation.data.channels import is_session, session_channels
from estimation.data.import_file import Imported, import_file
from estimation.data.import_options import ImportOptions, parse_pairs
from estimation.data.session_streams import import_extra, import_streams

__all__ = [
    "ImportOptions",
    "Imported",
    "import_extra",
    "import_file",
    "import_streams",
    "is_session",
    "parse_pairs",
    "session_channels",
]
