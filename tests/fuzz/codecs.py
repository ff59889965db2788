"""Random and damaged frames for every codec, and independent checks of what it accepts.

A codec may refuse bytes with `ProtocolError` and nothing else. What it accepts is encoded again by the
emulator of the device, or read bit by bit as the manual says: that must be what came.
"""

import re
import struct
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.robot_io.drivers import moteus
from palpate.robot_io.drivers import odrive_protocol as odrive
from palpate.robot_io.drivers.can.line import CanFrame
from palpate.robot_io.drivers.dynamixel import protocol as dynamixel
from palpate.robot_io.drivers.feetech import protocol as feetech
from palpate.robot_io.drivers.mit import protocol as mit
from palpate.robot_io.drivers.mit.protocol import DamiaoFrames, MitFrames, RobstrideFrames
from palpate.robot_io.drivers.mit.settings import DIALECTS, Maker
from palpate.robot_io.drivers.net_ft import NetFtStream
from palpate.robot_io.drivers.serial_force.bota import FRAME_SIZE, BotaStream
from palpate.robot_io.drivers.serial_force.gauges import Mark10Stream, loadstar_stream, pattern_stream
from palpate.robot_io.drivers.serial_force.lorenz import LorenzStream, Telegram, TelegramReader
from palpate.robot_io.drivers.serial_force.microcontroller_cell import CellStream
from palpate.robot_io.drivers.serial_force.stream import Poll
from palpate.robot_io.errors import ProtocolError
from palpate.sim_backend.emulators import dynamixel as dynamixel_wire
from palpate.sim_backend.emulators import feetech as feetech_wire
from palpate.sim_backend.emulators import net_ft, serial_sensors
from palpate.sim_backend.emulators.servo_wire import BROADCAST

Rng = np.random.Generator
MOST_RANDOM = 64  # bytes of a random input


@dataclass(frozen=True)
class Codec:
    """A codec under test; each trial begins with a new decoder."""

    frame: Callable[[Rng, int], bytes]  # a valid frame, the number of frames before it given
    decoder: Callable[[], Callable[[bytes], list]]  # what is accepted of some bytes
    # Of this input, the stream's last bytes, what was accepted
    is_wrong: Callable[[bytes, bytes, object], bool]
    memory: int = 0  # bytes of earlier inputs that what is accepted may come from


@dataclass(frozen=True)
class Result:
    """What a codec made of its inputs."""

    accepted: int  # values
    refused: int  # inputs
    wrong: tuple[str, ...]  # values that should not have been accepted
    crashes: tuple[str, ...]  # other exceptions


def run(codec: Codec, inputs: int, rng: Rng) -> Result:
    """Feed random bytes (a quarter) and damaged frames to a codec."""
    decode, seen = codec.decoder(), b""
    accepted, refused, wrong, crashes = 0, 0, [], []
    for number in range(inputs):
        data = make_input(codec, number, rng)
        seen = (seen + data)[-codec.memory - len(data) :]
        try:
            values = decode(data)
        except ProtocolError:
            refused += 1
            continue
        except Exception as error:
            crashes.append(f"{type(error).__name__}: {error} for {data.hex()}")
            continue
        accepted += len(values)
        wrong += [f"{value} from {data.hex()}" for value in values if codec.is_wrong(data, seen, value)]
    return Result(accepted, refused, tuple(wrong), tuple(crashes))


def make_input(codec: Codec, number: int, rng: Rng) -> bytes:
    """Random bytes, or a frame with up to two faults and perhaps the beginning of another behind it."""
    if rng.random() < 0.25:
        return rng.bytes(int(rng.integers(MOST_RANDOM)))
    data = bytearray(codec.frame(rng, number))
    for _ in range(int(rng.integers(3))):
        place, fault = int(rng.integers(len(data) + 1)), int(rng.integers(4))
        if fault == 0 and place < len(data):
            data[place] ^= 1 << int(rng.integers(8))
        elif fault == 1:
            del data[place : place + int(rng.integers(1, 4))]
        elif fault == 2:
            data[place:place] = rng.bytes(int(rng.integers(1, 4)))
        else:
            data[place:place] = data[place : place + 4]
    if rng.random() < 0.1:
        data += codec.frame(rng, number)[: int(rng.integers(1, 20))]
    return bytes(data)


def single(decode: Callable[[bytes], object]) -> Callable[[], Callable[[bytes], list]]:
    """A decoder without a state that takes exactly one frame."""
    return lambda: lambda data: [decode(data)]


def stream(make: Callable[[], object]) -> Callable[[], Callable[[bytes], list]]:
    """A decoder that finds frames in a stream; the codec's class or factory."""

    def decoder() -> Callable[[bytes], list]:
        reader = make()
        return lambda data: list(reader.feed(data))

    return decoder


# Status packets of servos: encoded again by the emulator, they are the bytes that came.


def tricky_bytes(rng: Rng, size: int, tricky: tuple[int, ...], share: float) -> bytes:
    """Bytes rich in what looks like headers and stuffing."""
    plain = rng.integers(256, size=size, dtype=np.uint8)
    return np.where(rng.random(size) < share, rng.choice(np.array(tricky, np.uint8), size), plain).tobytes()


def dynamixel_data(rng: Rng, size: int) -> bytes:
    return tricky_bytes(rng, size, (0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0xFE, 0x01), 0.5)


def dynamixel_status(rng: Rng, _number: int) -> bytes:
    """A status packet; one in ten is an instruction, such as the echo of a request."""
    data = dynamixel_data(rng, int(rng.integers(17)))
    packet = dynamixel_wire.status(int(rng.integers(253)), int(rng.integers(256)), data)
    if rng.random() < 0.9:
        return packet
    body = packet[:7] + bytes((int(rng.integers(0x10)),)) + packet[8:-2]  # the instruction is byte 7
    return body + dynamixel_wire.checksum(body).to_bytes(2, "little")


def feetech_status(rng: Rng, _number: int) -> bytes:
    """An answer; one in ten is the echo of a sync read."""
    data = tricky_bytes(rng, int(rng.integers(40)), (0xFF, 0xFF, 0xFE, 0x00, 0x02, 0x82), 0.3)
    servo_id = int(rng.integers(253)) if rng.random() < 0.9 else BROADCAST
    return feetech_wire.status(servo_id, int(rng.integers(64)), data)


def encoded_status(encode: Callable[[int, int, bytes], bytes], accepted: object) -> bytes:
    """The packet that an accepted status must have been; no stream holds the bytes of what is no status."""
    if not isinstance(accepted, tuple) or len(accepted) != 3 or not 0 <= accepted[0] < 253:
        return b"no packet"
    return encode(*accepted)


def servo_codecs(name: str, frame, encode, decode_status, reader) -> dict[str, Codec]:
    """The codec of one packet and that of a stream of packets."""
    return {
        f"{name}_packet": Codec(
            frame, single(decode_status), lambda data, _, accepted: encoded_status(encode, accepted) != data
        ),
        f"{name}_stream": Codec(
            frame,
            stream(reader),
            lambda _, seen, accepted: encoded_status(encode, accepted) not in seen,
            2048,
        ),
    }


_IDS, _SIZE = (1, 2, 3), 13  # of servos that a fast sync read asks, and bytes of each


def fast_reply(rng: Rng, _number: int) -> bytes:
    """The common answer of three servos; one in ten comes in another order."""
    ids = rng.permutation(_IDS).tolist() if rng.random() < 0.1 else _IDS
    parts = [(i, int(rng.integers(256)), dynamixel_data(rng, _SIZE)) for i in ids]
    return dynamixel_wire.fast_status(parts, len(ids))


def is_wrong_fast_reply(data: bytes, _seen: bytes, accepted) -> bool:
    parts = [(part.servo_id, part.error, part.data) for part in accepted]
    return [part[0] for part in parts] != list(_IDS) or dynamixel_wire.fast_status(parts, 3) != data


# Motors on CAN, whose adapter checks the frame: an accepted state, packed again, gives the same bits.

_MIT, _DAMIAO = MitFrames(0, {}), DamiaoFrames(0, {})
_RANGES = DIALECTS[Maker.CUBEMARS].models["AK70-10"]
_MIT_FIELDS = ((12.5, 16), (50.0, 12), (25.0, 12))  # range and bits of position, velocity, torque


def mit_frame(rng: Rng, _number: int) -> bytes:
    """Six bytes, with a supply voltage behind them in newer firmware, or with temperature and error."""
    return b"\x01" + rng.bytes(int(rng.choice((5, 6, 7), p=(0.2, 0.2, 0.6))))


def is_wrong_mit(data: bytes, _seen: bytes, accepted) -> bool:
    """Each number, truncated as by the motor and written bit by bit, must stand where it came from."""
    if not isinstance(accepted, mit.MitState) or len(data) not in (6, 7, 8):
        return True
    bits = f"{accepted.motor_id:08b}"
    values = (accepted.position_rad, accepted.velocity_rad_s, accepted.torque_nm)
    for value, (limit, count) in zip(values, _MIT_FIELDS, strict=True):
        number = int((value + limit) / (2.0 * limit) * (2**count - 1) + 1e-6)
        bits += f"{number:0{count}b}" if 0 <= number < 2**count else "beyond"
    came = "".join(f"{byte:08b}" for byte in data)
    error = int(came[56:], 2) if len(data) == 8 else 0
    at_end = any(len(set(field)) == 1 for field in (came[8:24], came[24:36]))
    return bits != came[:48] or accepted.error != error or accepted.at_range_end != at_end


def is_wrong_damiao(data: bytes, seen: bytes, accepted) -> bool:
    """The status stands above the id, temperatures in the last bytes; judged in the layout of the others."""
    if not isinstance(accepted, mit.MitState) or len(data) != 8:
        return True
    status = data[0] // 16
    error = status if status > 1 else 0
    if (accepted.enabled, accepted.error) != (status == 1, error):
        return True
    return is_wrong_mit(bytes((data[0] % 16, *data[1:7], error)), seen, accepted)


def robstride_frame(rng: Rng, _number: int) -> bytes:
    """The first four bytes are the id."""
    return bytes((2, int(rng.integers(256)), 1, 0xFD)) + rng.bytes(8)


def robstride_decoder() -> Callable[[bytes], list]:
    frames = RobstrideFrames(0xFD, {})

    def decode(data: bytes) -> list:
        frame = CanFrame(int.from_bytes(data[:4], "big") & 0x1FFFFFFF, data[4:], extended=True)
        return [frames.state(frame, _RANGES)] if frames.sender(frame) == 1 else []

    return decode


def is_wrong_robstride(data: bytes, _seen: bytes, accepted) -> bool:
    """By the bits of the manual, of motor 1 to host FD."""
    if not isinstance(accepted, mit.MitState) or len(data) != 12:
        return True
    bits = "".join(f"{byte:08b}" for byte in data)
    shares = (accepted.position_rad / 12.5, accepted.velocity_rad_s / 50.0, accepted.torque_nm / 25.0)
    numbers = "".join(f"{int((share + 1.0) / 2.0 * 65535 + 1e-6):016b}" for share in shares)
    mode = {True: ("10",), False: ("00", "01")}.get(bool(accepted.enabled), ())
    at_end = any(len(set(field)) == 1 for field in (bits[32:48], bits[48:64]))
    return (
        bits[3:8] + bits[16:32] != "00010" + "00000001" + "11111101"
        or bits[8:10] not in mode
        or accepted.error != int(bits[10:16], 2)
        or (accepted.motor_id, accepted.at_range_end) != (1, at_end)
        or numbers != bits[32:80]
    )


_FLOATS = struct.Struct("<fff")


def moteus_frame(rng: Rng, _number: int) -> bytes:
    floats = rng.bytes(12) if rng.random() < 0.5 else _FLOATS.pack(*rng.normal(size=3))
    return b"\x21\x00" + rng.bytes(1) + b"\x2f\x01" + floats + b"\x20\x04\x0c" + rng.bytes(4)


def is_wrong_moteus(data: bytes, _seen: bytes, accepted) -> bool:
    if not isinstance(accepted, moteus.MoteusState):
        return True
    floats = (accepted.position_rev, accepted.velocity_rev_s, accepted.torque_nm)
    rest = (accepted.home, round(2.0 * accepted.supply_v), accepted.temperature_c, accepted.fault)
    again = bytes((0x21, 0x00, accepted.mode % 256, 0x2F, 0x01)) + _FLOATS.pack(*floats)
    again += bytes((0x20, 0x04, 0x0C, *(value % 256 for value in rest)))
    finite = bool(np.isfinite(floats).all())
    return (finite and again != data) or len(again) != len(data) or bool(accepted.unknown) == finite


_ODRIVE_STATES = {0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14}
_ODD_FLOATS = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38], dtype="<f4")
_ODRIVE_PARTS = ("motor", "encoder", "controller")  # with a flag each in the last three bytes of firmware 0.5


def odrive_frame(rng: Rng, _number: int) -> bytes:
    """The first byte says which message it is, the others are its data; some floats are no number."""
    floats = rng.normal(size=2).astype("<f4")
    if rng.random() < 0.2:
        floats[rng.integers(2)] = rng.choice(_ODD_FLOATS)
    beat = rng.bytes(4) + bytes((8, *rng.integers(256, size=3).tolist()))
    return bytes((int(rng.integers(6)),)) + (beat if rng.random() < 0.3 else floats.tobytes())


def decode_odrive(data: bytes) -> object:
    frame = CanFrame(0x20, data[1:])
    match data[0] % 6 if data else 0:
        case 0:
            return odrive.decode_heartbeat(frame, odrive.Firmware.V0_5)
        case 1:
            return odrive.decode_heartbeat(frame, odrive.Firmware.V0_6)
        case 5:
            return odrive.decode_version(frame)
        case _:
            return odrive.decode_two_floats(frame, "floats")


def is_wrong_odrive(data: bytes, _seen: bytes, accepted) -> bool:
    """It must be what numpy reads there."""
    if len(data) != 9:
        return True
    kind, content = data[0] % 6, np.frombuffer(data[1:], dtype=np.uint8)
    if kind == 5:
        return accepted != tuple(content[4:7].tolist())
    if kind > 1:
        floats = content.view("<f4")
        return not np.isfinite(floats).all() or accepted != tuple(floats.tolist())
    error, state, *flags = int(content[:4].view("<u4")[0]), *content[4:].tolist()
    failed = tuple(part for part, flag in zip(_ODRIVE_PARTS, flags, strict=True) if flag & 1)
    expected = (error, state, failed if kind == 0 else ())
    if not isinstance(accepted, odrive.Heartbeat) or state not in _ODRIVE_STATES:
        return True
    return (accepted.axis_error, accepted.state, accepted.component_errors) != expected


# Force sensors.


def bota_frame(rng: Rng, number: int) -> bytes:
    status = 0 if rng.random() < 0.9 else 1 << int(rng.integers(16))
    return serial_sensors.bota_frame(status, rng.normal(scale=30.0, size=6).tolist(), 1250 * (number + 1))


def is_wrong_bota(_data: bytes, seen: bytes, accepted) -> bool:
    """A force must be that of a frame with the CRC that the emulator would have made."""

    def holds(body: bytes) -> bool:
        data, status = body[:-2], body[0] + 256 * body[1]
        if serial_sensors.bota_crc(data) != body[-2] + 256 * body[-1] or status & ~2:
            return False
        force_n = float(np.frombuffer(data[10:14], "<f4")[0])
        return accepted in ((force_n,) if status == 0 else (force_n, 100.0, -100.0))

    starts = (place for place in range(len(seen) - FRAME_SIZE + 1) if seen[place] == 0xAA)
    return not any(holds(seen[place + 1 : place + FRAME_SIZE]) for place in starts)


def lorenz_telegram(rng: Rng, _number: int) -> bytes:
    parameters = rng.choice(np.array([0, 1, 2, 3, 255], np.uint8), int(rng.integers(12))).tobytes()
    return serial_sensors.telegram(int(rng.integers(256)), 255, parameters)


def is_wrong_telegram(data: bytes, _seen: bytes, accepted) -> bool:
    if not isinstance(accepted, Telegram):
        return True
    again = (accepted.command, accepted.receiver, accepted.parameters, accepted.sender)
    return serial_sensors.telegram(*again) not in data


def lorenz_samples(rng: Rng, number: int) -> bytes:
    """Six samples, each behind its counter."""
    return b"".join(bytes(((6 * number + k) % 256,)) + rng.bytes(2) for k in range(6))


def is_wrong_lorenz_sample(_data: bytes, seen: bytes, accepted) -> bool:
    """A value must stand between two counters that go on by one."""
    counts = int(2.0 * accepted)
    value = bytes((counts // 256 % 256, counts % 256))
    return not any(
        (seen[place + 3] - seen[place]) % 256 == 1 and seen[place + 1 : place + 3] == value
        for place in range(len(seen) - 3)
    )


def net_ft_record(rng: Rng, number: int) -> bytes:
    status = 0 if rng.random() < 0.9 else 1 << int(rng.integers(32))
    return net_ft.record(number + 1, 7 * (number + 1), status, rng.integers(-(2**31), 2**31, 6).tolist())


def is_wrong_net_ft(data: bytes, _seen: bytes, accepted) -> bool:
    """36 bytes, no error, and counts at the place of the axis."""
    counts = int.from_bytes(data[16:20], "big", signed=True)
    status = int.from_bytes(data[8:12], "big")
    is_bad = len(data) != 36 or bool(status & 0x7FFEFFFF) or abs(counts) >= 2**31 - 1
    return is_bad or accepted != float(counts)


def is_number(word: bytes, value: object) -> bool:
    try:
        return float(word) == value
    except ValueError:
        return False


def lines(seen: bytes) -> list[bytes]:
    return re.split(rb"[\r\n]", seen)


def force_line(form: str) -> Callable[[Rng, int], bytes]:
    return lambda rng, _number: form.format(rng.normal(scale=30.0)).encode()


def is_wrong_first_word(_data: bytes, seen: bytes, accepted) -> bool:
    return not any(is_number(line.split()[0], accepted) for line in lines(seen) if line.split())


def is_wrong_mark10(_data: bytes, seen: bytes, accepted) -> bool:
    """The number must stand before the unit, and nothing else in its line."""
    words = (line.strip().split(b" ") for line in lines(seen))
    return not any(rest == [b"N"] and is_number(first, accepted) for first, *rest in words)


def is_wrong_cell(_data: bytes, seen: bytes, accepted) -> bool:
    """The number must be the last word of a line with the CRC that the emulator would have made."""
    parts = (line.rpartition(b"*") for line in lines(seen))
    sound = (text.split() for text, _, digits in parts if digits == b"%04X" % crc_hqx(text, 0xFFFF))
    return not any(is_number(words[-1], accepted) for words in sound if words)


CODECS: dict[str, Codec] = {
    **servo_codecs(
        "dynamixel",
        dynamixel_status,
        dynamixel_wire.status,
        dynamixel.decode_status,
        lambda: dynamixel.DynamixelStatusReader(128),
    ),
    "dynamixel_fast_reply": Codec(
        fast_reply, lambda: lambda data: [dynamixel.FastReply(_IDS, _SIZE).decode(data)], is_wrong_fast_reply
    ),
    **servo_codecs(
        "feetech",
        feetech_status,
        feetech_wire.status,
        feetech.decode_status,
        lambda: feetech.FeetechStatusReader(largest=64),
    ),
    "mit": Codec(mit_frame, single(lambda data: _MIT.state(CanFrame(0, data), _RANGES)), is_wrong_mit),
    "mit_damiao": Codec(
        mit_frame, single(lambda data: _DAMIAO.state(CanFrame(0, data), _RANGES)), is_wrong_damiao
    ),
    "mit_robstride": Codec(robstride_frame, robstride_decoder, is_wrong_robstride),
    "moteus": Codec(
        moteus_frame,
        single(lambda data: moteus.decode_state(CanFrame(0x100, data, fd=True))),
        is_wrong_moteus,
    ),
    "odrive": Codec(odrive_frame, single(decode_odrive), is_wrong_odrive),
    "bota": Codec(bota_frame, stream(lambda: BotaStream("z", 100.0)), is_wrong_bota, 100),
    "lorenz_telegram": Codec(
        lorenz_telegram, lambda: lambda data: list(TelegramReader().feed(data)), is_wrong_telegram
    ),
    "lorenz_stream": Codec(lorenz_samples, stream(lambda: LorenzStream(0.5)), is_wrong_lorenz_sample, 100),
    "net_ft": Codec(
        net_ft_record, lambda: lambda data: list(NetFtStream(1.0, "y", 1000).feed(data)), is_wrong_net_ft
    ),
    "loadstar": Codec(
        force_line("{:12.4f}\r\n"), stream(lambda: loadstar_stream(1.0, 100.0)), is_wrong_first_word, 400
    ),
    "mark10": Codec(
        force_line("{:.2f} N\r\n"),
        stream(lambda: Mark10Stream("N", 100.0, "M7-50", Poll(b"?", b"!"))),
        is_wrong_mark10,
        400,
    ),
    "force_lines": Codec(
        force_line("{:.3f} N\r\n"),
        stream(lambda: pattern_stream(r"\s*(?P<value>[-+]?[\d.]+) (?P<unit>N)", None, 1.0)),
        is_wrong_first_word,
        400,
    ),
    "microcontroller_cell": Codec(
        lambda rng, number: serial_sensors.cell_line(
            f"{(number + 1) % 256} {int(rng.integers(-(1 << 23), 1 << 23))}"
        ),
        stream(lambda: CellStream(1.0, 0.0, 100.0, 320.0)),
        is_wrong_cell,
        400,
    ),
}
