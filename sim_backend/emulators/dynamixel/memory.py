"""The bytes behind a control table: reading, writing by its rules, indirect addressing, loss of power."""

from collections.abc import Callable

from sim_backend.emulators.dynamixel.control_table import (
    EEPROM_END,
    INDIRECT_ADDRESS,
    Error,
    Item,
    Model,
)


class Memory:
    """One servo's memory.

    Args:
        items: rows of its control table by address.
        model: where its indirect data is.
    """

    def __init__(self, items: dict[int, Item], model: Model) -> None:
        self._items = items
        self._indirect = range(model.indirect_data, model.indirect_data + model.indirect_count)
        self._bytes = bytearray(self._indirect.stop)
        for item in items.values():
            self.put(item.address, item.initial)

    def lose_power(self) -> None:
        """Everything above the EEPROM is as at the start."""
        for item in self._items.values():
            if item.address >= EEPROM_END:
                self.put(item.address, item.initial)

    def get(self, address: int) -> int:
        """The value of an item; negative ones by its range."""
        item = self._items[address]
        signed = item.low is not None and item.low < 0
        data = self._bytes[address : address + item.size]
        return int.from_bytes(data, "little", signed=signed)

    def put(self, address: int, value: int) -> None:
        """Set an item from inside the servo; nothing is checked."""
        item = self._items[address]
        data = (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
        self._bytes[address : address + item.size] = data

    def read(self, address: int, size: int) -> bytes | Error:
        """What an instruction reads, or why it cannot."""
        if size < 1 or address + size > len(self._bytes):
            return Error.ACCESS
        return bytes(self._bytes[self._meant(place)] for place in range(address, address + size))

    def write(self, address: int, data: bytes, allowed: Callable[[Item, int], Error]) -> Error:
        """What an instruction writes: whole items in a row.

        Args:
            address: of the first byte.
            data: bytes.
            allowed: says for an item and its new value whether the servo takes it now.
        """
        place, end = address, address + len(data)
        while place < end:
            item = self._items.get(self._meant(place))
            if item is None or not item.writable:
                return Error.ACCESS
            raw = data[place - address : place - address + item.size]
            if len(raw) < item.size:
                return Error.DATA_LENGTH
            value = int.from_bytes(raw, "little", signed=item.low is not None and item.low < 0)
            error = _outside(item, value) or allowed(item, value)
            if error:
                return error
            place += item.size
        for offset, byte in enumerate(data):
            self._bytes[self._meant(address + offset)] = byte
        return Error.NONE

    def _meant(self, place: int) -> int:
        """The byte that indirect data stands for; others stand for themselves."""
        if place not in self._indirect:
            return place
        at = INDIRECT_ADDRESS + 2 * (place - self._indirect.start)
        return self._bytes[at] + 256 * self._bytes[at + 1]


def _outside(item: Item, value: int) -> Error:
    if item.low is not None and value < item.low:
        return Error.DATA_RANGE
    if item.high is not None and value > item.high:
        return Error.DATA_RANGE
    return Error.NONE
