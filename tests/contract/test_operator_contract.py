"""Contract of every operator device."""

import numpy as np
import pytest

from palpate.control.teleop.leader_arm import OPERATOR_DEVICES, LeaderArm, build_operator_device
from palpate.robot_io.clock import MonotonicClock, SimulatedClock
from palpate.robot_io.errors import DeviceError, InputError, LifecycleError, SafetyTripError
from tests.contract.operators import OPERATOR_SETUPS

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(params=OPERATOR_SETUPS, ids=lambda operator_setup: operator_setup.name)
def operator_setup(request, tmp_path):
    made = request.param(tmp_path)
    yield made
    made.close()


@pytest.fixture
def active(operator_setup):
    operator_setup.device.configure()
    operator_setup.device.activate()
    operator_setup.device.read()
    operator_setup.wait(0.005)  # an arm's guard limits how fast its torque rises
    return operator_setup


def test_every_operator_device_has_a_contract_test():
    assert {operator_setup.name for operator_setup in OPERATOR_SETUPS} == set(OPERATOR_DEVICES)


def test_calls_out_of_order_are_refused(operator_setup):
    device = operator_setup.device
    for call in (device.read, device.activate, lambda: device.set_force(UP)):
        with pytest.raises(LifecycleError):
            call()
    with device:
        with pytest.raises(LifecycleError):
            device.set_force(UP)
        with pytest.raises(LifecycleError):
            device.configure()
    with pytest.raises(LifecycleError):
        device.read()


def test_device_reads_meters_upwards_and_its_button(operator_setup):
    for _ in range(2):
        with operator_setup.device as device:
            hand = device.read()
            assert hand.position_world_m.shape == hand.velocity_world_m_s.shape == (3,)
            assert np.isfinite(hand.position_world_m).all()
            assert 0.0 <= operator_setup.clock.now_s() - hand.sampled_at_s <= operator_setup.oldest_s
            assert not hand.select
        device.close()
    with operator_setup.device as device:
        before = device.read()
        operator_setup.move()
        after = device.read()
    assert 0.002 < after.position_world_m[2] - before.position_world_m[2] < 0.15
    assert after.sampled_at_s > before.sampled_at_s
    with operator_setup.device as device:
        operator_setup.press()
        assert device.read().select


def test_forces_are_rendered_within_range_until_deactivation(active):
    force = np.array([0.3, 0.0, 0.5])
    assert active.device.set_force(force) == pytest.approx(force, abs=0.02)
    active.device.deactivate()
    active.device.deactivate()
    with pytest.raises(LifecycleError):
        active.device.set_force(UP)
    active.device.activate()


@pytest.mark.parametrize("force", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0], [[0, 0, 0]]], ids=str)
def test_invalid_force_is_refused_and_the_device_continues(active, force):
    with pytest.raises(InputError):
        active.device.set_force(np.array(force))
    assert active.device.set_force(0.1 * UP) == pytest.approx(0.1 * UP, abs=0.02)


def test_lost_device_raises_an_error_and_closes(operator_setup):
    operator_setup.device.configure()
    operator_setup.device.read()
    operator_setup.unplug()
    with pytest.raises(DeviceError):
        operator_setup.wait(0.2), operator_setup.device.read()
    operator_setup.device.close()


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("keyboard", {"terminal": "/nowhere"}),
        ("keyboard", {"terminal": "/dev/null"}),
        ("gamepad", {"port": "/nowhere"}),
        ("mouse", {"port": "/nowhere"}),
        ("touch", {"library": "/nowhere.so"}),
        ("touch", {"library": "libc.so.6"}),
    ],
)
def test_missing_device_is_named(name, settings):
    device = build_operator_device(name, settings, SimulatedClock())
    with pytest.raises(DeviceError, match=next(iter(settings.values()))):
        device.configure()


def test_unknown_names_and_settings_are_refused():
    with pytest.raises(InputError, match="gamepad"):
        build_operator_device("gamepat", {}, SimulatedClock())
    with pytest.raises(InputError, match="speed_m_s"):
        build_operator_device("gamepad", {"speed": 1.0}, SimulatedClock())


@pytest.mark.parametrize(
    "operator_setup", [b for b in OPERATOR_SETUPS if b.name in {"scripted", "keyboard"}], indirect=True
)
def test_modeled_hand_yields_by_its_stiffness(active):
    active.wait(5.0)
    before = active.device.read().position_world_m
    active.device.set_force(-6.0 * UP)
    active.wait(1.0)
    assert before - active.device.read().position_world_m == pytest.approx([0.0, 0.0, 0.01], abs=1e-5)


@pytest.mark.parametrize("operator_setup", [b for b in OPERATOR_SETUPS if b.name == "touch"], indirect=True)
class TestTouch:
    def test_axes_units_and_limit(self, active):
        active.move()
        hand = active.device.read()
        assert hand.position_world_m == pytest.approx([0.4 - 0.03, -0.01, 0.15 + 0.02])
        assert hand.velocity_world_m_s == pytest.approx([0.0, 0.0, 0.05])
        assert active.device.set_force(np.array([0.0, 6.6, 0.0])) == pytest.approx([0.0, 3.3, 0.0])
        active.device.set_force(np.array([1.0, 2.0, 2.0]))
        active.wait(0.005)
        assert active.force() == pytest.approx([-2.0, 2.0, -1.0])

    def test_watchdog_ends_the_force(self, operator_setup):
        settings = operator_setup.device.Settings(
            library=operator_setup.settings()["library"], watchdog_s=1e-3
        )
        operator_setup.device = type(operator_setup.device)(settings, operator_setup.clock)
        operator_setup.device.configure()
        operator_setup.device.activate()
        operator_setup.device.set_force(UP)
        operator_setup.wait(0.005)  # the servo thread sleeps for 1 ms each time
        assert operator_setup.force() == pytest.approx(np.zeros(3))

    def test_device_is_released(self, active):
        assert active.library.stand_in_open()
        active.device.close()
        assert not active.library.stand_in_open()

    def test_another_device_is_refused(self, operator_setup):
        other = type(operator_setup.device)(
            operator_setup.device.Settings(device="Left", library=operator_setup.settings()["library"]),
            MonotonicClock(),
        )
        with pytest.raises(DeviceError, match="0x0300"):
            other.configure()


@pytest.mark.parametrize(
    "operator_setup", [b for b in OPERATOR_SETUPS if b.name == "leader_arm"], indirect=True
)
class TestLeaderArm:
    def test_rendered_force_balances_a_hand(self, active):
        """A hand that pushes up with 2 N against a force of 2 N downwards: nothing moves."""
        device, plant = active.device, active.bus.plant
        before = device.read().position_world_m
        plant.hand_force_n = 2.0
        for _ in range(100):
            device.read()
            device.set_force(-2.0 * UP)
            active.wait(1e-3)
        assert device.read().position_world_m == pytest.approx(before, abs=2e-3)
        for _ in range(100):
            device.read()
            device.set_force(0.0 * UP)
            active.wait(1e-3)
        assert device.read().position_world_m[2] > before[2] + 5e-3

    def test_force_out_of_plane_is_not_rendered(self, active):
        assert active.device.set_force(np.array([0.0, 3.0, 1.0])) == pytest.approx([0.0, 0.0, 1.0], abs=0.02)

    def test_device_guard_limits_force(self, active):
        assert np.linalg.norm(active.device.set_force(-500.0 * UP)) < 60.0
        assert isinstance(active.device, LeaderArm)
        assert np.abs(active.bus.staged_nm).max() <= 15.0

    @pytest.mark.parametrize("ticks", [0, 20])
    def test_stall_stops_the_device_also_after_its_activation(self, active, ticks):
        """It went on with the force that was wanted by then."""

        def push(ticks):
            for _ in range(ticks):
                active.device.read()
                active.device.set_force(UP)
                active.wait(1e-3)

        push(ticks)
        active.wait(0.15)
        with pytest.raises(SafetyTripError, match="the program was held up"):
            push(4000)

    def test_trip_brakes_the_device_and_is_reported_at_the_end(self, active):
        device, plant = active.device, active.bus.plant

        def push_hard_for(ticks):
            for tick in range(ticks):
                plant.hand_force_n = 60.0 if tick < 15 else 0.0
                device.read()
                device.set_force(0.0 * UP)
                active.wait(1e-3)

        with pytest.raises(SafetyTripError, match="60 N, limit 30 N"):
            push_hard_for(4000)  # braked, lowered, off
        assert np.abs(plant.velocity_rad_s).max() < 0.01
