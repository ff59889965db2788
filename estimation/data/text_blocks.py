"""Where the tables of a text file lie: several tests may follow each other, each below its own header."""

import re
from collections.abc import Iterator

from estimation.data.text_dialect import Dialect, is_footer

_BLANKS = b" \t"
_ENDS = (b"\n", b"\r")


def find_blocks(content: bytes, dialect: Dialect) -> tuple[list[tuple[int, int]], tuple[str, ...]]:
    """First byte of each table's rows and the one after its last, and a word on lines below the last one."""
    heads = list(_found(content, content[dialect.head : dialect.start], dialect.head))
    ends = [*(begin for begin, _ in heads[1:]), len(content)]
    blocks = [_trimmed(content, head[1], end, dialect) for head, end in zip(heads, ends, strict=True)]
    filled = [(begin, end) for begin, end in blocks if end > begin]
    if not filled:  # then a reader can say best what is wrong with these lines
        return [(heads[0][1], len(content))], ()
    below = [line for line in content[blocks[-1][1] :].splitlines() if line.strip()]
    words = (f"a footer of {len(below)} line{'s' if len(below) > 1 else ''}",) if below else ()
    return filled, words


def _found(content: bytes, head: bytes, place: int) -> Iterator[tuple[int, int]]:
    """Where lines begin and end that are those at a place, which is the first, but for blanks behind them."""
    lines = [line.rstrip(_BLANKS) for line in head.splitlines()]
    alike = re.compile(b"".join(re.escape(line) + rb"[ \t]*(?:\r\n|\r|\n|\Z)" for line in lines))
    while place >= 0:
        met = alike.match(content, place)
        if met and (place == 0 or content[place - 1 : place] in _ENDS):
            yield met.span()
        place = content.find(lines[0], place + 1)


def _trimmed(content: bytes, begin: int, end: int, dialect: Dialect) -> tuple[int, int]:
    """A block without the lines at its end that are no rows."""
    ends = dict.fromkeys(_ENDS, end)  # where each was met last, so that every byte is looked at once
    while end > begin:
        line = end - (2 if content.endswith(b"\r\n", begin, end) else 1)
        ends |= {mark: content.rfind(mark, begin, line) for mark, place in ends.items() if place >= line}
        last = max(begin, *(place + 1 for place in ends.values()))
        if not is_footer(content[last:end].decode(errors="replace").strip("\r\n"), dialect):
            break
        end = last
    return begin, end
