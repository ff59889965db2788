"""Connection: loopback, restart, bad network, and peers without a certificate."""

import json
import subprocess
import time
from contextlib import ExitStack
from math import nan

import psutil
import pytest

from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.connection import Impairment, LinkConnection, LinkSettings, NetworkEmulator
from palpate.robot_io.link.frame import MOST_BYTES, load_seal
from tests.files import saved
from tests.free_port import free_port
from tests.robot_io.link.link_parts import intent, report, target

WAIT_S = 20.0


def heard(sender: LinkConnection, receiver: LinkConnection, message, wait_s: float = WAIT_S) -> bool:
    """Whether a message arrives, sent again and again."""
    return any_heard([(sender, receiver, message)], wait_s)


def any_heard(pairs, wait_s: float) -> bool:
    """Whether any of several messages arrives, (sender, receiver, message) each, all sent again and again."""
    until_s = time.monotonic() + wait_s
    while time.monotonic() < until_s:
        for sender, _, message in pairs:
            sender.send(message)
        time.sleep(0.02)
        come = {receiver: receiver.receive() for receiver in {receiver for _, receiver, _ in pairs}}
        if any(frame.message == message for _, receiver, message in pairs for _, frame in come[receiver]):
            return True
    return False


def test_both_ends_hear_each_other_also_after_a_restart():
    settings, clock = LinkSettings(port=free_port()), MonotonicClock()
    with LinkConnection("leader", settings, clock) as leader:
        for _ in range(2):
            with LinkConnection("follower", settings, clock) as follower:
                assert heard(leader, follower, intent(target()))
                assert heard(follower, leader, report())
                follower.resubscribe()
                assert heard(leader, follower, intent(target()))


def test_second_follower_is_refused_in_one_line():
    settings, clock = LinkSettings(port=free_port()), MonotonicClock()
    with (
        LinkConnection("follower", settings, clock),
        pytest.raises(InputError, match="is another follower using it") as refused,
    ):
        LinkConnection("follower", settings, clock)
    assert ".rs" not in str(refused.value)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ('{mode: "peer", nosuch: 3}', "line 1, column 16: unknown field `nosuch`"),
        ('{mode: "peer" listen}', "line 1, column 8: expected boolean or null"),
        ('{mode: "hub"}', "unknown variant `hub`"),
        ('{mode: "peer", listen: {endpoints: ["tcp127.0.0.1:7"]}}', "Endpoints must be of the form"),
        (
            '{mode: "peer", listen: {endpoints: ["tls/127.0.0.1:0"]}, transport: {link: {tls: '
            '{listen_private_key: "none.key", listen_certificate: "none.pem"}}}}',
            "listen_private_key: no file 'none.key'",
        ),
        (None, "No such file"),
    ],
)
def test_zenoh_error_is_one_line(config, words, tmp_path):
    path = tmp_path / "link.json5"
    if config is not None:
        path.write_text(config)
    with pytest.raises(InputError) as refused:
        LinkConnection("follower", LinkSettings(config=path), MonotonicClock())
    said = str(refused.value)
    assert words in said
    assert str(path) in said
    assert not [part for part in ("\n", ".rs", ".cargo") if part in said]


@pytest.mark.parametrize(
    "values", [{"seed": -1}, {"delay_s": nan}, {"jitter_s": -1.0}, {"loss": nan}, {"loss": 1.0}]
)
def test_impossible_network_is_refused(values):
    with pytest.raises(InputError):
        Impairment(**values)


def write_key(path, key=b"sixteen bytes at least"):
    path.touch(0o600)
    path.write_bytes(key)
    return path


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_key_that_others_can_read_is_refused(mode, tmp_path):
    key = write_key(tmp_path / "pair.key")
    load_seal(key, "topic")
    key.chmod(mode)
    with pytest.raises(InputError, match=rf"pair\.key: other users can .* \(mode {mode:o}\); run chmod 600"):
        LinkConnection("follower", LinkSettings(port=free_port(), key=key), MonotonicClock())
    key.chmod(0o600)
    other = write_key(tmp_path / "tls.key")
    other.chmod(mode)
    config = tmp_path / "link.json5"
    tls = {"listen_private_key": str(other), "listen_certificate": str(key)}
    config.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
    with pytest.raises(InputError, match=rf"listen_private_key .*tls\.key: .* \(mode {mode:o}\)"):
        LinkConnection("follower", LinkSettings(config=config), MonotonicClock())


@pytest.mark.parametrize(
    ("config", "open_to"),
    [
        ({"listen": {"endpoints": ["tcp/0.0.0.0:{port}"]}}, "tcp/0.0.0.0"),
        ({"listen": {"endpoints": ["tcp/[::]:{port}#iface=lo"]}}, "tcp/[::]"),
        ({"listen": {"endpoints": {"peer": ["tcp/127.0.0.1:{port}", "udp/10.0.0.1:7"]}}}, "udp/10.0.0.1:7"),
        ({"listen": {"endpoints": ["tcp/localhost.example:{port}"]}}, "tcp/localhost.example"),
        ({"mode": "client", "connect": {"endpoints": ["tcp/router.lab:7447"]}}, "tcp/router.lab:7447"),
        ({"listen": {"endpoints": ["tls/0.0.0.0:{port}"]}}, "tls/0.0.0.0"),  # anybody may connect
        ({"scouting": {"multicast": {"enabled": True}}}, "scouting.multicast.enabled"),
    ],
)
def test_follower_without_key_or_certificates_stays_on_this_machine(config, open_to, tmp_path):
    path, port = tmp_path / "link.json5", free_port()
    path.write_text(json.dumps(config).replace("{port}", str(port)))
    with pytest.raises(InputError, match="Give --key FILE on both sides") as refused:
        LinkConnection("follower", LinkSettings(config=path, port=port), MonotonicClock())
    assert open_to in str(refused.value)


def test_access_control_denies_unlisted_key_expressions(tmp_path):
    """zenoh listens everywhere and looks for peers in the network where a configuration says nothing."""
    path, port, key = tmp_path / "link.json5", free_port(), write_key(tmp_path / "pair.key")
    path.write_text("{}")
    with LinkConnection("follower", LinkSettings(config=path, port=port), MonotonicClock()) as line:
        assert line.is_open_here
        assert listening_on() == {f"127.0.0.1:{port}"}
    with LinkConnection("follower", LinkSettings(port=port), MonotonicClock()) as line:
        assert line.is_open_here
        assert listening_on() == {f"127.0.0.1:{port}"}
    with LinkConnection("follower", LinkSettings(port=port, key=key), MonotonicClock()) as line:
        assert not line.is_open_here


def listening_on():
    """Addresses at which this process listens for connections."""
    return {
        f"{one.laddr.ip}:{one.laddr.port}"
        for one in psutil.Process().net_connections("tcp")
        if one.status == psutil.CONN_LISTEN
    }


def test_pairs_of_another_name_do_not_hear_each_other():
    port, clock = free_port(), MonotonicClock()
    with (
        LinkConnection("follower", LinkSettings("one", port), clock) as follower,
        LinkConnection("leader", LinkSettings("two", port), clock) as other,
        LinkConnection("leader", LinkSettings("one", port), clock) as leader,
    ):
        assert heard(leader, follower, intent(target()))
        assert not heard(other, follower, intent(target(1)), 0.2)


def test_peer_with_another_key_is_ignored_and_reported(tmp_path):
    port, clock = free_port(), MonotonicClock()
    for name in ("ours", "theirs"):
        write_key(tmp_path / name, name.encode() * 8)
    with (
        LinkConnection("follower", LinkSettings(port=port, key=tmp_path / "ours"), clock) as follower,
        LinkConnection("leader", LinkSettings(port=port, key=tmp_path / "theirs"), clock) as other,
        LinkConnection("leader", LinkSettings(port=port), clock) as plain,
        LinkConnection("leader", LinkSettings(port=port, key=tmp_path / "ours"), clock) as leader,
    ):
        strangers = [(one, follower, intent(target(1))) for one in (other, plain)]
        until_s = time.monotonic() + WAIT_S
        while not (follower.refused and plain.refused) and time.monotonic() < until_s:
            assert not any_heard([*strangers, (follower, plain, report())], 0.1)
        assert "this side's key" in follower.refused
        assert "made with a key" in plain.refused
        assert heard(leader, follower, intent(target()))
        assert not any_heard([*strangers, (follower, plain, report())], 0.2)


def test_advice_names_shared_settings_and_the_cost_of_udp(tmp_path):
    path = tmp_path / "udp.json5"
    path.write_text('{listen: {endpoints: ["udp/127.0.0.1:0"]}, scouting: {multicast: {enabled: false}}}')
    with LinkConnection("follower", LinkSettings(config=path), MonotonicClock()) as line:
        assert "--link" in line.advice
        assert "open_timeout" in line.advice
    with LinkConnection("follower", LinkSettings(port=free_port()), MonotonicClock()) as line:
        assert "--port" in line.advice
        assert "UDP" not in line.advice


def test_network_emulator_delays_and_drops_as_configured():
    network = NetworkEmulator(Impairment(delay_s=0.5, jitter_s=0.05, loss=0.2, seed=3))
    for number in range(5000):
        network.put(b"%d" % number, 0.0)
    assert network.due(0.2) == []
    early, late = network.due(0.5), network.due(1.0)
    assert len(early) + len(late) == pytest.approx(4000, abs=100)
    assert len(early) == pytest.approx(len(late), rel=0.1)
    assert early != sorted(early, key=int)  # some have overtaken others


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"port": 80}, "port 80"), ({"name": "a/b"}, "link name"), ({"name": ""}, "link name")],
)
def test_invalid_line_settings_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        LinkSettings(**settings)


def certificates(folder) -> None:
    """A CA, and a certificate of its own for "side"; "stranger" has one of another CA."""

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    (folder / "names").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    for ca, side in (("ca", "side"), ("other_ca", "stranger")):
        key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout"]
        openssl("req", "-x509", *key, f"{ca}.key", "-out", f"{ca}.pem", "-days", "2", "-subj", f"/CN={ca}")
        openssl("req", *key, f"{side}.key", "-out", f"{side}.csr", "-subj", f"/CN={side}")
        signed = ["-CA", f"{ca}.pem", "-CAkey", f"{ca}.key", "-CAcreateserial", "-extfile", "names"]
        openssl("x509", "-req", "-in", f"{side}.csr", "-out", f"{side}.pem", "-days", "2", *signed)


def secured(folder, way: str, side: str, port: int):
    """A zenoh configuration with certificates on both sides, and only the two keys of the pair allowed."""
    tls = {
        "root_ca_certificate": str(folder / "ca.pem"),
        "enable_mtls": True,
        "listen_private_key": str(folder / f"{side}.key"),
        "listen_certificate": str(folder / f"{side}.pem"),
        "connect_private_key": str(folder / f"{side}.key"),
        "connect_certificate": str(folder / f"{side}.pem"),
    }
    messages = ["put", "declare_subscriber"]
    rule = {"id": "pair", "permission": "allow", "flows": ["ingress", "egress"], "messages": messages}
    endpoints = {"endpoints": [f"tls/127.0.0.1:{port}"]}
    config = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "listen": endpoints if way == "listen" else {"endpoints": []},
        "connect": {"endpoints": [], "exit_on_failure": False} | (endpoints if way == "connect" else {}),
        "transport": {"link": {"tls": tls}},
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule | {"key_exprs": ["palpate/arm/**"]}],
            "subjects": [{"id": "anybody with a certificate"}],
            "policies": [{"rules": ["pair"], "subjects": ["anybody with a certificate"]}],
        },
    }
    return saved(folder / f"{way}-{side}.json5", json.dumps(config))


def test_peer_without_our_certificate_is_refused_and_other_keys_are_denied(tmp_path):
    certificates(tmp_path)
    port, other_port, clock = free_port(), free_port(), MonotonicClock()
    with ExitStack() as stack:

        def line(role, side: str, port: int, name: str = "arm") -> LinkConnection:
            config = secured(tmp_path, "listen" if role == "follower" else "connect", side, port)
            return stack.enter_context(LinkConnection(role, LinkSettings(name, config=config), clock))

        follower, stranger = line("follower", "side", port), line("leader", "stranger", port)
        plain = stack.enter_context(LinkConnection("leader", LinkSettings(port=port), clock))
        # The certificates of these two are good, the key is not.
        elsewhere = [line(role, "side", other_port, "elsewhere") for role in ("leader", "follower")]
        pairs = [(stranger, follower, intent(target())), (plain, follower, intent(target(2)))]
        # The leader that starts last is heard, so those that started earlier had enough time.
        assert heard(line("leader", "side", port), follower, intent(target()))
        assert not any_heard([*pairs, (*elsewhere, intent(target(1)))], 0.5)


def test_both_sides_meet_through_a_router(tmp_path):
    import zenoh

    endpoint = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
    router, client = (
        {"mode": mode, way: endpoint, "scouting": {"multicast": {"enabled": False}}}
        for mode, way in (("router", "listen"), ("client", "connect"))
    )
    path = saved(tmp_path / "client.json5", json.dumps(client))
    settings, clock = LinkSettings(config=path), MonotonicClock()
    with (
        zenoh.open(zenoh.Config.from_json5(json.dumps(router))),  # what the program zenohd is
        LinkConnection("leader", settings, clock) as leader,
        LinkConnection("follower", settings, clock) as follower,
    ):
        assert heard(leader, follower, intent(target()))
        assert heard(follower, leader, report())


def test_oversized_data_are_dropped_on_arrival():
    import zenoh

    settings, clock = LinkSettings(port=free_port()), MonotonicClock()
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{settings.port}"]))
    with LinkConnection("follower", settings, clock) as follower, zenoh.open(config) as stranger:
        until_s = time.monotonic() + WAIT_S
        while not follower.malformed and time.monotonic() < until_s:
            stranger.put("palpate/arm/leader", bytes(MOST_BYTES + 1))
            time.sleep(0.05)
        assert follower.malformed
        assert not follower._waiting
