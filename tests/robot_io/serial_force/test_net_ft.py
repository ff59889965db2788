"""ATI Net F/T: records against the emulator, damage, range and configuration."""

import re
import socket

import pytest

from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers import net_ft
from palpate.robot_io.drivers.net_ft import (
    NetFtLineSettings,
    NetFtSettings,
    NetFtStream,
    decode_record,
    parse_configuration,
)
from palpate.robot_io.errors import DeviceError, InputError, ProtocolError
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.types import Status
from palpate.sim_backend.emulators.net_ft import EmulatedNetFt, record
from tests.wire.parts import NET_FT, ODRIVE


@pytest.mark.parametrize("size", [0, 35, 37, 72])
def test_datagram_of_another_size_is_refused(size):
    with pytest.raises(ProtocolError):
        decode_record(bytes(size))


def test_requests_are_those_of_the_manual():
    assert net_ft.START.hex() == "1234000200000000"
    assert net_ft.STOP.hex() == "1234000000000000"


def fed(*records, axis="z"):
    stream = NetFtStream(1e-6, axis, 1000)
    return stream, [force for one in records for force in stream.feed(record(*one))]


@pytest.mark.parametrize(("axis", "force_n"), [("x", 1.0), ("y", -2.0), ("z", 3.0)])
def test_chosen_axis_is_read(axis, force_n):
    counts = [1_000_000, -2_000_000, 3_000_000, 7, 8, 9]
    assert fed((1, 7, 0, counts), axis=axis)[1] == [force_n]


@pytest.mark.parametrize(
    ("pairs", "taken"),
    [
        ([(1, 7), (2, 14)], 2),
        ([(1, 7), (1, 7)], 1),  # twice
        ([(2, 14), (1, 7)], 1),  # out of order
        ([(1, 7), (9, 63)], 2),  # some are lost
        ([(2**32 - 1, 7), (0, 14)], 2),  # the counter begins anew
        ([(1, 7), (2, 7)], 1),  # nothing new was measured
        ([(1, 7), (1 + 2**31, 14)], 1),  # so far ahead that it is behind
    ],
)
def test_only_new_records_are_taken(pairs, taken):
    stream, forces = fed(*((*pair, 0, [0] * 6) for pair in pairs))
    assert len(forces) == taken
    assert stream.rejected == len(pairs) - taken
    assert not stream.fault_text


@pytest.mark.parametrize(
    ("status", "said", "forces"),
    [
        (0, "", [1.0]),
        (0x80010000, "", [1.0]),  # a monitor condition was latched: nothing is wrong with the force
        (0xC0000000, "force or torque out of range (status 0xc0000000)", []),
        (0x88000000, "gage out of range (status 0x88000000)", []),
        (0x80020000, "transducer saturated (status 0x80020000)", []),
        (0x80000002, "supply voltage (status 0x80000002)", []),
        (0x80000005, "temperature, broken gage (status 0x80000005)", []),
        (0x00000008, "busy (status 0x00000008)", []),
        (0x800000A0, "other error, calibration not accessible (status 0x800000a0)", []),
        (0xB0000000, "simulated error, calibration checksum (status 0xb0000000)", []),
        (0x80000000, "error (status 0x80000000)", []),
        (0x80000400, "unknown bits 0x400 (status 0x80000400)", []),
    ],
)
def test_status_is_an_error_or_nothing(status, said, forces):
    stream, found = fed((1, 7, status, [0, 0, 1_000_000, 0, 0, 0]))
    assert found == forces
    assert stream.fault_text == (f"the sensor says '{said}'" if said else "")
    assert stream.feed(record(2, 14, 0, [0] * 6)) == [0.0]
    assert not stream.fault_text


@pytest.mark.parametrize("counts", [2**31 - 1, -(2**31 - 1), -(2**31)])
def test_counts_at_their_end_are_no_force(counts):
    stream, found = fed((1, 7, 0, [0, 0, counts, 0, 0, 0]))
    assert not found
    assert stream.fault_text == "the sensor says 'counts at the end of their range'"


def test_restarted_counter_is_named_before_its_samples_are_too_old(make_robot):
    """It was named after 50 records, and the arm stopped by the age of its sample after 10 ms."""
    arm = make_robot(ODRIVE, NET_FT)
    arm.robot.configure()
    arm.ticks(100, None)
    arm.sensor._sequence = 0
    arm.ticks(5, None)
    assert "sensor's counter restarted" in arm.problem


def test_repeated_old_records_are_no_restart():
    sequence = (*range(1, 200), *range(150, 171), 200, 10, 11, 201)
    stream, forces = fed(*((number, 7 * number, 0, [0] * 6) for number in sequence))
    assert not stream.fault_text
    assert len(forces) == 201


@pytest.mark.parametrize(
    ("first", "old", "is_named"),
    [
        *((500, 49, False), (500, 50, True), (1, 59, True)),
        *((1, 2, False), (1, 3, True), (18, 3, True), (19, 3, False)),  # three of the first twenty
    ],
)
def test_fifty_old_records_or_three_of_the_first_are_a_restart(first, old, is_named):
    """No network repeats so many; far from its beginning, a counter shows nothing else."""
    stream, _ = fed((1000, 7000, 0, [0] * 6), *((first + k, 7 * k, 0, [0] * 6) for k in range(old)))
    assert ("sensor's counter restarted" in stream.fault_text) == is_named


PAGE = EmulatedNetFt(NetFtSettings(axis="z", capacity_n=100.0, counts_per_force=1e6, unit="N")).page()


def test_configuration_page_is_read():
    *values, settings = parse_configuration(PAGE)
    assert values == ["Ethernet F/T", 1e6, "N", 1000, True]
    names = {"cfgcpf", "cfgtfx", "comrdte", "comrdtrate", "scfgfu", "setbias", "setcfgsel", "setuserfilter"}
    assert settings.keys() == names


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"<cfgcpf>1000000</cfgcpf>", b"", "'cfgcpf' is missing"),
        (b">1000000<", b">many<", "not a number"),
        (b">1000000<", b">0<", "0 counts per N"),
        (b">1000000<", b">inf<", "inf counts per N"),
        (b">1000000<", b">nan<", "nan counts per N"),
        (b">1000<", b">1e3<", "not a number"),
        (b">1000<", b">0<", "0 records per second"),
        (b">N<", b">psi<", "'psi' is not a known unit"),
        (PAGE, b"<html>login</html>", "is missing"),
        (PAGE, b"\xff" * 100_000, "is missing"),
    ],
)
def test_invalid_configuration_page_is_refused(old, new, said):
    with pytest.raises(ProtocolError, match=said):
        parse_configuration(PAGE.replace(old, new))


@pytest.fixture
def arm(make_robot):
    return make_robot(ODRIVE, NET_FT)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        ({"counts_per_force": 1000.0}, "counts 1000 for 1 N, but the robot file states 1000000 for 1 N"),
        ({"unit": "lbf"}, "counts 1000000 for 1 lbf, but the robot file states"),
        ({"enabled": False}, "RDT is disabled"),
        ({"receive": lambda data, now_s: b""}, "sends no records"),
        ({"page": lambda: b"no"}, "is not the configuration of a Net F/T sensor"),
        ({"page": lambda: b""}, "answers '404 Not Found': is it a Net F/T sensor"),  # by the emulated server
    ],
)
def test_sensor_that_is_set_up_otherwise_is_refused(arm, spoil, said):
    vars(arm.sensor).update(spoil)
    with pytest.raises(DeviceError, match=said):
        arm.robot.configure()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        ({"counts_per_force": 1000.0}, "'cfgcpf' was '1000000' and is '1000'"),
        ({"unit": "lbf"}, "'scfgfu' was 'N' and is 'lbf'"),
        *(
            ({"settings": {name: "7"}}, f"'{name}' was '0.*' and is '7'")
            for name in ("setbias", "setuserfilter", "setcfgsel", "cfgtfx")
        ),
    ],
)
def test_sensor_that_is_changed_meanwhile_is_refused(arm, spoil, said):
    """A run with wrong forces went unnoticed, at its end as at the start of the next one."""
    arm.start()
    arm.robot.verify()
    vars(arm.sensor).update(spoil)
    with pytest.raises(DeviceError, match=said):
        arm.robot.verify()
    arm.robot.deactivate()
    with pytest.raises(DeviceError, match=said):
        arm.robot.activate()
    assert {node.state for node in arm.motors} == {1}


def configure_with(arm, old, new):
    text, changes = re.subn(old, new, arm.text)
    assert changes
    with build_robot(parse_robot_file(text, ODRIVE), DriverCatalog(), arm.clock) as robot:
        robot.configure()


def test_missing_peer_is_reported(arm, monkeypatch):
    closed = []
    monkeypatch.setattr(net_ft.HTTPConnection, "close", lambda connection: closed.append(connection.host))
    arm.arm.wires["load_cell"].close()
    with pytest.raises(DeviceError, match=r"netftapi2.xml: no answer \(.*; check power, cable, host"):
        arm.robot.configure()
    assert closed == ["127.0.0.1"]


def test_wrong_port_is_named(arm):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        nobody.bind(("127.0.0.1", 0))
        port = nobody.getsockname()[1]
    with pytest.raises(DeviceError, match="sends no records; check rdt_port"):
        configure_with(arm, r"rdt_port: \d+", f"rdt_port: {port}")


@pytest.mark.parametrize("host", ["http://192.168.1.1", "192.168.1.1:80", "192.168.1.1 ", "a b", ""])
def test_only_a_plain_address_is_accepted(host):
    with pytest.raises(InputError, match=r"host: give its address alone, such as 192\.168\.1\.1"):
        validate(NetFtLineSettings, {"host": host})


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        *(("host: 127.0.0.1", f"host: {bad}", "cannot be reached") for bad in ("..", "x" * 64, "no.invalid")),
        *(
            ("counts_per_force: 1000000", f"counts_per_force: {bad}", "another configuration is active")
            for bad in ("1.0e-320", "1.0e+300")
        ),
    ],
)
def test_invalid_host_and_unreasonable_scale_are_named(arm, old, new, said):
    with pytest.raises(DeviceError, match=said):
        configure_with(arm, old, new)


def test_first_request_may_be_lost_and_the_stream_is_ended(arm):
    heard, receive = [], arm.sensor.receive
    arm.sensor.receive = lambda data, now_s: (
        heard.append(data) or (b"" if len(heard) < 3 else receive(data, now_s))
    )
    arm.robot.configure()
    assert heard == [net_ft.START] * 3
    assert arm.ticks(5, None).force_status is not Status.FAULT
    arm.robot.close()
    arm.clock.sleep_until(arm.clock.now_s() + 0.01)
    assert heard[-1] == net_ft.STOP
    assert not arm.sensor._timer.running


def test_sensor_that_repeats_its_measurement_is_silent_and_named(arm):
    arm.robot.configure()
    arm.ticks(10, None)
    arm.sensor.measures = False
    before = arm.tick(None)
    assert arm.ticks(20, None).force_at_s <= before.force_at_s + 1.3e-3
    assert "no reading for" in arm.problem
    arm.ticks(60, None)
    assert "its readings do not change" in arm.problem


def test_error_of_one_record_between_two_polls_is_a_fault(arm):
    """The next record was good, and the arm went on."""
    arm.robot.configure()
    arm.ticks(10, None)
    for arm.sensor.status in (0x80020000, 0):
        arm.clock.sleep_until(arm.clock.now_s() + 1e-3)
    assert arm.tick(None).force_status is Status.FAULT
    assert "transducer saturated" in arm.problem
    assert arm.ticks(10, None).force_status is Status.OK


def test_looks_between_two_records_count_no_damage(arm):
    arm.robot.configure()
    arm.ticks(10, None)
    reader = arm.robot.buses["load_cell"]._reader
    reader.read_port()
    assert reader.rejected == 0


def test_samples_buffered_during_a_pause_include_the_pause(arm):
    """A network keeps hundreds of datagrams for a program that does not read."""
    arm.robot.configure()
    arm.ticks(10, None)
    reader = arm.robot.buses["load_cell"]._reader
    read_port, reader.read_port = reader.read_port, lambda wait_s=0.0: None
    stood_s = arm.clock.now_s()
    arm.clock.sleep_until(stood_s + 0.1)
    reader.read_port = read_port
    reader.read_port()
    assert reader.newest.arrived_at_s <= stood_s + 0.5e-3


def test_records_of_another_host_are_ignored(arm):
    arm.robot.configure()
    arm.ticks(10, None)
    ours = arm.robot.buses["load_cell"]._port._socket.getsockname()
    before_n = arm.tick(None).force_n
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(record(10_000, 70_000, 0, [99_000_000] * 6), ours)
    assert arm.ticks(3, None).force_n == pytest.approx(before_n, abs=1.0)
