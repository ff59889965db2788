"""What fuzzers of servos' status packets have in common, whatever the protocol.

What is accepted is encoded again by the emulator, which shares no code with the codec: these bytes, with all
that the protocol adds, must be those that came.
"""

from abc import abstractmethod

from .fuzzer import Fuzzer, StreamFuzzer


class StatusFuzzer(Fuzzer):
    """A decoder of status packets."""

    @abstractmethod
    def again(self, servo_id: int, error: int, data: bytes) -> bytes:
        """The packet with this content, by the emulator."""

    def encoded(self, accepted: object) -> bytes:
        """The packet that an accepted one must have been; nothing starts with what is no packet."""
        if not isinstance(accepted, tuple) or len(accepted) != 3 or not 0 <= accepted[0] < 253:
            return b"no packet"
        return self.again(*accepted)

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        return self.encoded(accepted) != data


class StatusStreamFuzzer(StreamFuzzer, StatusFuzzer):
    """A reader that finds packets in a stream."""

    memory = 2048

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """Whether its bytes are not in the stream."""
        return self.encoded(accepted) not in self.seen
