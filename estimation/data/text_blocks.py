"""Where the tables of a text file lie: several tests may follow each other, each below its own header."""

from collections.abc import Iterator

from estimation.data.text_dialect import Dialect, is_footer


def find_blocks(content: bytes, dialect: Dialect) -> tuple[list[tuple[int, int]], tuple[str, ...]]:
    """First byte of each table's rows and the one after its last, and a word on lines below the last one."""
    head = content[dialect.head : dialect.start]
    heads = list(_found(content, head, dialect.head))
    begins = [place + len(head) for place in heads]
    blocks = [
        _trimmed(content, *block, dialect) for block in zip(begins, [*heads[1:], len(content)], strict=True)
    ]
    below = [line for line in content[blocks[-1][1] :].splitlines() if line.strip()]
    words = (f"a footer of {len(below)} line{'s' if len(below) > 1 else ''}",) if below else ()
    return [(begin, end) for begin, end in blocks if end > begin], words


def _found(content: bytes, head: bytes, place: int) -> Iterator[int]:
    """Where lines begin that are the same as those at a place, which is the first."""
    while place >= 0:
        if place == 0 or content[place - 1 : place] in (b"\n", b"\r"):
            yield place
        place = content.find(head, place + len(head))


def _trimmed(content: bytes, begin: int, end: int, dialect: Dialect) -> tuple[int, int]:
    """A block without the lines at its end that are no rows."""
    while end > begin:
        last = content.rfind(b"\n", begin, end - 1) + 1 or begin
        if not is_footer(content[last:end].decode(errors="replace").strip("\r\n"), dialect):
            break
        end = last
    return begin, end
