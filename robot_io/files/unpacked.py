"""How much memory a packed file may take: as much as it costs somebody to make and to send, within reason."""

_ALWAYS = 128 * 1024**2  # bytes: an hour of four columns at 1 kHz, whatever they hold
_TIMES = 20  # packed size; measurements with noise come to 2 to 5, steady signals to 15


def most_unpacked(packed_bytes: int) -> int:
    """Bytes that a file of this size may hold; one that holds more was made to fill the memory."""
    return _ALWAYS + _TIMES * packed_bytes
