"""Text that came from the names of files, for files of text."""


def as_utf8(text: str) -> str:
    """The text with a question mark for each byte of a file's name that is none: UTF-8 cannot hold it."""
    return text.encode("utf-8", "replace").decode("utf-8")
