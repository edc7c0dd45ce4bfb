"""The bus on the time of the test: arbitration, bit times, loss, error frames and bus-off."""

from __future__ import annotations

import pytest
from can_fake_bench import Bench

from lfield_sim.can.can_bus import ERROR_BUS_OFF, CanFrame


def identifiers(frames: list[CanFrame]) -> list[int]:
    return [frame.identifier for frame in frames]


def test_the_lowest_waiting_identifier_is_sent_first():
    bench = Bench()
    other: list[CanFrame] = []
    bench.listen(other)
    for identifier in (0x300, 0x200, 0x7FF, 0x100):
        bench.send(identifier)
    bench.send(0x100 << 18, extended=True)
    bench.send(0x100, remote=True)
    bench.wait()
    assert [(f.identifier, f.extended, f.remote) for f in other] == [
        (0x100, False, False),
        (0x100, False, True),
        (0x100 << 18, True, False),
        (0x200, False, False),
        (0x300, False, False),
        (0x7FF, False, False),
    ]
    assert bench.received == [], "a sender does not receive its own frames"


def test_frame_in_transmission_is_not_interrupted():
    bench = Bench()
    other: list[CanFrame] = []
    bench.listen(other)
    bench.send(0x300)
    bench.world.advance(bench.now)
    bench.send(0x100)
    bench.wait()
    assert identifiers(other) == [0x300, 0x100]


@pytest.mark.parametrize(("bitrate", "frames"), [(1_000_000, 90), (125_000, 11)])
def test_frames_take_their_bit_time(bitrate, frames):
    bench = Bench(bitrate=bitrate)
    other: list[CanFrame] = []
    bench.listen(other)
    for _ in range(200):
        bench.send(0x100, bytes(8))
    bench.wait(0.010)
    assert len(other) == pytest.approx(frames, abs=1)


def test_fd_data_with_bit_rate_switch_is_faster():
    slow, fast = (
        CanFrame(1, bytes(64), fd=True, switch=switch).seconds(5e5, 5e6) for switch in (False, True)
    )
    assert slow > 5 * fast
    assert CanFrame(1, bytes(8), extended=True).seconds(1e6, 1e6) > CanFrame(1, bytes(8)).seconds(1e6, 1e6)


def test_port_with_another_bit_rate_is_isolated():
    bench = Bench()
    other: list[CanFrame] = []
    wrong = bench.listen(other, bitrate=500_000)
    bench.send(0x100)
    bench.world.bus.send(wrong, CanFrame(0x200), bench.now)
    bench.wait()
    assert (bench.received, other) == ([], [])
    wrong.bitrate = 1_000_000
    bench.send(0x100)
    bench.wait()
    assert identifiers(other) == [0x100]


def test_loss_drops_its_share_of_frames():
    bench = Bench()
    other: list[CanFrame] = []
    bench.listen(other)
    bench.fault("loss=0.3")
    for _ in range(1000):
        bench.send(0x100)
    bench.wait(0.1)
    assert 640 < len(other) < 760
    bench.fault("loss=1")
    bench.send(0x100)
    assert bench.wait() == []


def test_loss_of_one_device_spares_the_others():
    bench = Bench("cia402:5", "cia402:6")
    bench.wait(1.0)
    bench.fault("loss@5=1")
    received = identifiers(bench.wait(1.0))
    assert received.count(0x705) == 0
    assert received.count(0x706) == 5


def test_corrupted_frame_gives_an_error_frame_and_is_resent():
    bench = Bench()
    other: list[CanFrame] = []
    bench.listen(other)
    bench.fault("corrupt=0.05")
    for _ in range(200):
        bench.send(0x100)
    bench.wait(0.05)
    assert sum(not f.error for f in other) == 200
    assert any(f.error for f in other)
    assert any(f.error for f in bench.received), "the sender sees the error too"


def test_sender_that_never_succeeds_goes_bus_off_and_recovers():
    bench = Bench()
    other: list[CanFrame] = []
    bench.listen(other)
    bench.fault("corrupt=1")
    bench.send(0x100)
    bench.wait(0.02)
    assert sum(f.identifier == ERROR_BUS_OFF for f in bench.received) == 1
    assert sum(f.error for f in other) == 32, "transmit errors count in eights up to 256"
    bench.fault("corrupt=0")
    bench.send(0x101)
    bench.wait(0.02)
    assert [f.identifier for f in other if not f.error] == [0x101], "frames queued before bus-off are dropped"


def test_bus_off_carries_no_frames_and_is_reported_once():
    bench = Bench("cia402:5")
    bench.wait(0.5)
    bench.fault("bus_off=true")
    received = bench.wait(1.0)
    assert [(f.identifier, f.error) for f in received] == [(ERROR_BUS_OFF, True)]
    bench.fault("bus_off=false")
    assert 0x705 in identifiers(bench.wait(0.5))


def test_detached_device_keeps_running_and_unpowered_device_boots_again():
    bench = Bench("cia402:5:alpha.winch")
    bench.wait(0.5)
    bench.fault("bus_off@alpha.winch=true")
    assert bench.wait(0.5) == []
    bench.fault("bus_off@alpha.winch=false")
    assert {f.data for f in bench.wait(0.5)} == {b"\x7f"}
    bench.fault("silence@5=true")
    assert bench.wait(0.5) == []
    bench.fault("silence@5=false")
    assert bench.wait(0.1)[0] == CanFrame(0x705, b"\x00"), "boot-up"


def test_delay_postpones_the_answer():
    bench = Bench("cia402:5")
    bench.wait(0.05)
    bench.fault("delay@5=0.2")
    bench.send(0x605, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0]))
    assert 0x585 not in identifiers(bench.wait(0.15))
    assert 0x585 in identifiers(bench.wait(0.1))


def test_halted_world_does_not_catch_up():
    bench = Bench("cia402:5")
    bench.wait(0.5)
    bench.now += 3600.0
    assert len(bench.wait(0.1)) <= 1


def test_overloaded_bus_has_bounded_queues():
    bench = Bench("odrive:1", "odrive:2", bitrate=10_000)
    bench.wait(30.0)
    bench.fault("delay=10")
    bench.wait(20.0)
    assert all(device._port.waiting <= 1000 for device in bench.world._devices)
