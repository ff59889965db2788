"""The text in a file's bytes, whatever program wrote them."""

import codecs
from pathlib import Path

from robot_io.errors import InputError

_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\r\f\x1a\x1b")) + b"\x7f\x81\x8d\x8f\x90\x9d"  # none in a text
_LOOKED_AT = 1 << 16  # bytes
_OTHERS = (  # how files begin that are called text by mistake, and what to do with them
    (b"\x89PNG", "is a picture; save the measurements themselves"),
    (b"\xff\xd8\xff", "is a picture; save the measurements themselves"),
    (b"%PDF", "is a PDF; save the measurements themselves"),
    (b"PK\x03\x04", "is a packed archive, perhaps a workbook: let its name end in .xlsx or .npz"),
    (b"\x1f\x8b", "is packed: let its name end in .gz"),
    (b"PAR1", "is a Parquet file: let its name end in .parquet"),
)


def as_utf8(content: bytes, path: Path) -> tuple[bytes, str]:
    """The text as UTF-8 without a mark, and the name of the encoding if it was another.

    UTF-16 is known by its mark or by the zeros between Latin letters; what is no UTF-8 and has no control
    characters is Windows' Western European (cp1252), as testing machines write their degrees and umlauts.

    Raises:
        InputError: it is no text.
    """
    if content.startswith(codecs.BOM_UTF8):
        content = content[len(codecs.BOM_UTF8) :]
    encoding = _encoding(content)
    try:
        if encoding:
            return content.decode(encoding).encode(), encoding
        if not content.isascii():
            content.decode()
    except UnicodeDecodeError:
        if encoding or any(byte in _CONTROLS for byte in content[:_LOOKED_AT]):
            raise _no_text(content, path) from None
        return content.decode("cp1252", errors="replace").encode(), "cp1252"
    if b"\0" in content:
        raise _no_text(content, path)
    return content, ""


def _no_text(content: bytes, path: Path) -> InputError:
    other = (words for begins, words in _OTHERS if content.startswith(begins))
    return InputError(f"{path}: {next(other, 'is no text; save it as CSV in UTF-8')}")


def _encoding(content: bytes) -> str:
    """UTF-16 of either order, or empty."""
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return encoding
    head = content[:_LOOKED_AT]
    even, odd = head[::2], head[1::2]
    if len(head) < 4:
        return ""
    if odd.count(0) > 0.9 * len(odd) and even.count(0) == 0:
        return "utf-16-le"
    return "utf-16-be" if even.count(0) > 0.9 * len(even) and odd.count(0) == 0 else ""
