"""The model of the radio, on virtual time: delay, order, loss, bursts, the shared channel, outages."""

from __future__ import annotations

import random
import statistics
from collections.abc import Iterable

import pytest
from emulator.cells import CELLS, Cell, Channel, Link
from emulator.channel import SharedChannel
from emulator.packets import TCP, UDP, Header, read_header
from emulator.radio_model import Air

NAMES = ("alpha", "bravo", "charlie")


def air(cell: Cell, seed: int = 1) -> Air:
    made = Air(NAMES, seed)
    made.set_cell(cell)
    return made


def arrivals(model: Air, until: float = 1e9) -> list[tuple[float, int, bytes]]:
    """The time, destination and content of each packet, in the order of time."""
    found = []
    while (at := model.next_event()) is not None and at <= until:
        found += [(at, to, packet) for to, packet in model.advance(at)]
    return found


def fates(model: Air, count: int, every: float = 1.0, source: int = 0, to: int = 1) -> list[float | None]:
    """The delay of each packet, None for lost ones."""
    for number in range(count):
        model.send(number * every, source, to, number.to_bytes(4, "big"))
    found = {int.from_bytes(packet, "big"): at for at, _, packet in arrivals(model)}
    return [found[n] - n * every if n in found else None for n in range(count)]


def test_perfect_radio_delivers_at_once() -> None:
    assert fates(air(Cell()), 5) == [0.0] * 5


def test_delay_and_jitter_are_within_their_bounds() -> None:
    delays = [delay for delay in fates(air(Cell(Link(delay=0.1, jitter=0.02))), 500) if delay is not None]
    assert len(delays) == 500
    assert min(delays) + 1e-9 >= 0.1
    assert max(delays) <= 0.12 + 1e-9
    assert statistics.mean(delays) == pytest.approx(0.11, abs=0.002)


def test_packets_of_a_direction_stay_in_order() -> None:
    model = air(Cell(Link(delay=0.1, jitter=0.05)))
    for number in range(200):
        model.send(number * 0.001, 0, 1, bytes([number]))
    assert [packet[0] for _, _, packet in arrivals(model)] == list(range(200))


@pytest.mark.parametrize("loss", [0.0, 0.05, 0.2, 1.0])
def test_random_loss_is_independent_per_packet(loss: float) -> None:
    found = fates(air(Cell(Link(loss=loss))), 4000)
    assert found.count(None) / len(found) == pytest.approx(loss, abs=0.02)


def test_same_seed_gives_the_same_losses_despite_other_directions() -> None:
    link = Cell(Link(delay=0.1, jitter=0.02, loss=0.3))
    first = fates(air(link), 200)
    assert fates(air(link), 200) == first
    assert fates(air(link, seed=2), 200) != first
    busy = air(link)
    for number in range(50):
        busy.send(0.0, 1, 0, bytes([number]))
        busy.send(0.0, 0, 2, bytes([number]))
    arrivals(busy)
    busy.pop_lost()
    assert [d is None for d in fates(busy, 200)] == [d is None for d in first]


def test_burst_loss_affects_both_directions_for_the_configured_time_share() -> None:
    model = air(Cell(Link(fade=0.1, burst=0.25)))
    lost = []
    for number in range(40_000):
        at = number * 0.01
        model.send(at, 0, 1, b"there")
        model.send(at, 1, 0, b"back")
        list(model.advance(at))
        ways = [way for way, _ in model.pop_lost()]
        assert ways in ([], [(0, 1), (1, 0)])
        lost.append(bool(ways))
    assert statistics.mean(lost) == pytest.approx(0.1, abs=0.03)
    runs = sum(lost[n] and not lost[n - 1] for n in range(1, len(lost)))
    assert sum(lost) * 0.01 / runs == pytest.approx(0.25, abs=0.06)


def test_shared_channel_carries_one_packet_at_a_time() -> None:
    model = air(Cell(Link(delay=0.05), Channel(rate=8000)))
    for source, to in ((0, 1), (1, 0), (2, 0)):
        model.send(0.0, source, to, bytes(100))
    assert [(round(at, 6), to) for at, to, _ in arrivals(model)] == [(0.15, 1), (0.25, 0), (0.35, 0)]


def test_senders_take_turns_on_the_shared_channel() -> None:
    channel = SharedChannel[str](Channel(rate=8000), 3)
    for number in range(5):
        assert channel.offer(0.0, 0, f"a{number}", 100)
    assert channel.offer(0.0, 2, "c", 100)
    sent = list(channel.pop_started(10.0))
    assert [transmission.item for transmission in sent] == ["a0", "c", "a1", "a2", "a3", "a4"]
    assert [round(transmission.end, 6) for transmission in sent] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def test_free_channel_starts_sending_at_packet_arrival() -> None:
    channel = SharedChannel[str](Channel(rate=8000), 1)
    channel.offer(5.0, 0, "late", 100)
    ((_, _, begin, end),) = channel.pop_started(7.0)
    assert (begin, end) == (5.0, 5.1)
    assert channel.next_event is None


def test_packets_beyond_the_queue_are_lost() -> None:
    model = air(Cell(Link(), Channel(rate=8000, queue=250)))
    for _ in range(5):
        model.send(0.0, 0, 1, bytes(100))
    # One is on the channel, two are queued.
    assert len(model.pop_lost()) == 2
    assert len(arrivals(model)) == 3


def test_outage_loses_packets_sent_in_it() -> None:
    model = air(Cell(Link(delay=0.1)))
    model.cut(0, 1, until=5.0)
    assert [delay is None for delay in fates(model, 8)] == [True] * 5 + [False] * 3
    model.send(8.0, 0, 2, b"another pair")
    model.cut(0, 2, until=100.0)
    assert [at for at, _, _ in arrivals(model)] == [pytest.approx(8.1)]
    model.mend()
    model.send(9.0, 2, 0, b"x")
    assert len(arrivals(model)) == 1


def test_one_pair_may_have_another_link() -> None:
    model = air(Cell())
    model.set_link(Link(loss=1.0), 0, 1)
    assert fates(model, 3) == [None] * 3
    assert fates(model, 3, to=2) == [0.0] * 3


def test_cells_match_their_names_after_a_json_round_trip() -> None:
    assert {name: Cell.from_json(cell.as_json()) for name, cell in CELLS.items()} == CELLS
    trips = {name: 2 * cell.link.delay for name, cell in CELLS.items()}
    assert trips["50 ms"] == 0.05
    assert trips["200 ms + 5 %"] == 0.2
    assert trips["500 ms + 2 %"] == 0.5
    assert CELLS["57.6 kbit/s + 100 ms + 5 %"].channel.rate == 57600


def ipv4(protocol: int, behind: bytes, options: bytes = b"") -> bytes:
    length = 20 + len(options)
    return (
        bytes([0x40 | length // 4])
        + bytes(8)
        + bytes([protocol])
        + bytes(6)
        + b"\n\x4d\0\2"
        + options
        + behind
    )


UDP_PACKET = (40000).to_bytes(2, "big") + (8181).to_bytes(2, "big") + bytes(4) + b"hello"
TCP_PACKET = (
    (8181).to_bytes(2, "big") + (40000).to_bytes(2, "big") + bytes(8) + bytes([0x80]) + bytes(19) + b"hi"
)


@pytest.mark.parametrize(
    ("packet", "expected"),
    [
        (ipv4(UDP, UDP_PACKET), Header(b"\n\x4d\0\2", UDP, 8181, 33, 5)),
        (ipv4(TCP, TCP_PACKET), Header(b"\n\x4d\0\2", TCP, 8181, 54, 2)),
        (ipv4(TCP, TCP_PACKET, bytes(4)), Header(b"\n\x4d\0\2", TCP, 8181, 58, 2)),
        (ipv4(1, b"ping"), Header(b"\n\x4d\0\2", 1, 0, 24, 4)),
        (
            bytes([0x60]) + bytes(5) + bytes([UDP]) + bytes(33) + UDP_PACKET,
            Header(bytes(16), UDP, 8181, 53, 5),
        ),
        (b"", None),
        (bytes([0x45]) + bytes(10), None),
        (bytes([0x50]) + bytes(40), None),
    ],
)
def test_packet_header_is_decoded(packet: bytes, expected: Header | None) -> None:
    assert read_header(packet) == expected


def test_any_bytes_are_accepted_by_the_header_reader() -> None:
    rng = random.Random(1)
    packets: Iterable[bytes] = (ipv4(TCP, TCP_PACKET), ipv4(UDP, UDP_PACKET))
    for packet in packets:
        for cut in range(len(packet)):
            header = read_header(packet[:cut])
            assert header is None or header.size == cut
    for _ in range(2000):
        read_header(rng.randbytes(rng.randrange(70)))
