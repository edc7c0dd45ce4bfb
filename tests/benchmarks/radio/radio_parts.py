"""The parts of the figure of poor radio: hops, stops, outages, bytes at rest; each for one cell."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from emulator.cells import CELLS
from emulator.radio import Radio
from harness.checkout import Checkout
from harness.figure import Row
from harness.number_text import COUNT
from harness.processes import Child, ChildError, Processes
from harness.samples import Tick, chosen, sentence
from radio.radio_lanes import Lane, StopLane, address_changes, collect, watch
from radio.radio_lanes import outages as outages_of
from radio.radio_team import DESK, Prepared, RadioTeam

from lfield.testing.keyring import Keyring

#: Lanes that are measured at a time: with long round trips and with short ones.
LANES, FAST_LANES = 20, 8
#: Vehicles for each processor. A vehicle, its host and its guard use about a quarter of one; more vehicles
#: would make the processor the bottleneck.
VEHICLES_OF_A_PROCESSOR = 1.5
#: The least samples of a lane that justify its start.
SAMPLES_OF_A_LANE = 10
#: A round trip in s below which lanes keep a processor busy, and the size of a request in bytes.
FAST, SIZE = 0.09, 600
#: The cell and the seconds in which links from a perfect radio adapt to a longer round trip; without it
#: they fill a slow channel with retransmissions.
MEANWHILE, ADAPTS = "50 ms", 6.0
#: Bytes of a request of the size of a stop order.
ORDER = 150
#: Seconds between a lift and the next stop, in which the copter is released.
PAUSE = "0.6"
#: Samples of a lane that are not counted: the connection adapts to its round trip.
WARM_UP = 10
#: The seconds of outages, lanes with outages at a time, and seconds between two outages.
OUTAGES, LANES_WITH_OUTAGES, BETWEEN = (1.0, 5.0, 15.0, 30.0), 6, 4.0
#: The new address of a robot, and the seconds within which a contender must continue after the change.
OTHER_ADDRESS, WITHIN = "10.77.0.71", 30.0
#: Seconds after which links are idle, and seconds in which bytes at rest are counted.
SETTLES = 15.0
AT_REST = 30.0
#: Protocols that are compared with a hop, and with a stop; True: a new connection for every request.
PEERS = {"raw TCP": "TCP", "gRPC": "gRPC", "Zenoh over TCP": "Zenoh", "QUIC": "QUIC", "UDP, retry": "UDP"}
STOP_PEERS = {
    "TCP+TLS, new connection": ("TLS", True),
    "TCP+TLS, standing": ("TLS", False),
    "QUIC, new connection": ("QUIC", True),
    "QUIC, standing": ("QUIC", False),
    "UDP, retry": ("UDP", False),
}

_HERE = Path(__file__).parent
_PEERS, _DESK = str(_HERE / "radio_peers.py"), str(_HERE / "radio_desk.py")
#: Seconds for the start of a team.
_TIMEOUT = 120.0
_COPTER = "driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog]"

#: Starts a lane for each seed of a radio; the processes end with `Processes`.
Starter = Callable[[Processes, Sequence[int]], Sequence[Lane]]


def hops(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """Two hops of a coordinator, compared with requests of the same size."""
    over_zenoh = partial(travellers, checkout, over_zenoh=True)
    starters: dict[str, Starter] = {"lfield": partial(travellers, checkout), "lfield over Zenoh": over_zenoh}
    starters |= {name: peers(checkout, called, SIZE) for name, called in PEERS.items()}
    yield from _compared(f"hops, {cell}", starters, samples, tick, cell)
    tick(f"hops, {cell}, bytes")
    with Processes() as processes:
        (lane,) = travellers(checkout, processes, [1])
        count = max(20, min(samples, 200))
        collect([lane], cell, WARM_UP)
        lane.radio.reset()
        collect([lane], cell, count)
        sent = sum(each.bytes for each in lane.radio.counts().values())
        yield Row("", "lfield, bytes of one hop", COUNT, [round(sent / (2 * count))])


def stops(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """A stop of teams of one and of five hosts, by the command and the page, compared with small requests."""
    for hosts in map(int, chosen("HOSTS", ("1", "5"))):
        for way in chosen("WAYS", ("command", "watch open", "page")):
            case, label = f"stop of {hosts}, {cell}", f"lfield, {way}"
            tick(f"{case}, {way}")
            try:
                yield from _stops(checkout, samples, cell, hosts, way)
            except Exception as error:
                yield Row(case, label, error=sentence(error))
    starters = {
        name: peers(checkout, STOP_PEERS[name][0], ORDER, fresh=STOP_PEERS[name][1])
        for name in chosen("PEERS", tuple(STOP_PEERS))
    }
    yield from _compared(f"stop, {cell}", starters, samples, tick, cell)


def _stops(checkout: Checkout, samples: int, cell: str, hosts: int, way: str) -> Iterator[Row]:
    with Processes() as processes:
        most = int(VEHICLES_OF_A_PROCESSOR * (os.cpu_count() or 1) / hosts)
        seeds = _seeds(cell, samples, max(1, most))
        lanes = stopping(checkout, processes, seeds, hosts, way)
        found = collect(lanes, cell, samples)
        sizes = [size / 1000 for lane in lanes for size in lane.sizes]
        yield Row(f"stop of {hosts}, {cell}", f"lfield, {way}", samples=found)
        yield Row("", "load of this computer", COUNT, [round(os.getloadavg()[0], 1)])
        yield Row("", "sent and received for it", "kB", sizes)
        if again := sum(len(lane.again) for lane in lanes):
            yield Row("", "not confirmed, pressed again", COUNT, [again])


def outages(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """Seconds until traffic continues after an outage or a change of address.

    Every lane has each interruption once in a round.
    """
    rounds = max(1, samples // 100)
    starters: dict[str, Starter] = {"lfield": partial(travellers, checkout)}
    starters |= {name: peers(checkout, called, SIZE, pause=0.1) for name, called in PEERS.items()}
    found: dict[tuple[str, str], list[float]] = {}
    with Processes() as processes:
        lanes: list[tuple[str, Lane]] = []
        for name, start in starters.items():
            tick(f"outages, {name}, made ready")
            lanes += [(name, lane) for lane in start(processes, _seeds(cell, samples, LANES_WITH_OUTAGES))]
        every = [lane for _, lane in lanes]
        collect(every, cell, len(every))
        for _ in range(rounds):
            for case, delays in _interruptions(every, tick):
                for (name, _), delay in zip(lanes, delays, strict=True):
                    found.setdefault((f"{case}, {cell}", name), []).append(delay)
    label = ""
    for (case, name), delays in found.items():
        there = [delay for delay in delays if delay < WITHIN]
        yield Row("" if case == label else case, name, samples=there)
        if late := len(delays) - len(there):
            yield Row("", f"{name}: not within {WITHIN:g} s", COUNT, [late])
        label = case


def _interruptions(lanes: Sequence[Lane], tick: Tick) -> Iterator[tuple[str, list[float]]]:
    """One round: the name of each interruption, and the delay of every lane."""
    for seconds in OUTAGES:
        tick(case := f"outage of {seconds:g} s")
        yield case, outages_of(lanes, FAR, seconds)
        rest(lanes, BETWEEN)
    tick(case := "another address")
    yield case, address_changes(lanes, NEAR, OTHER_ADDRESS, WITHIN)
    rest(lanes, BETWEEN)


def rest(lanes: Sequence[Lane], seconds: float) -> None:
    """Wait, and read the lanes' output meanwhile."""
    end = time.monotonic() + seconds
    watch(lanes, lambda: time.monotonic() >= end)


#: The robots at both ends of a lane's path.
NEAR, FAR = "h0", "h1"


def idle(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """Bytes per second of a link in a team of five, of `watch` for each host, and of idle peers."""
    tick(f"at rest, {cell}")
    with Processes() as processes:
        (team,) = vehicles(checkout, processes, [1], 5)
        team.radio.set(CELLS[cell])
        yield Row(
            f"at rest, {cell}", "lfield, link of two hosts", "B/s", [_bytes_per_second(team.radio) / 10]
        )
        link_of_page(team)
        yield Row(
            f"at rest, {cell}", "lfield, watch of a vehicle", "B/s", [_bytes_per_second(team.radio, DESK) / 5]
        )
    for name, called in PEERS.items():
        with Processes() as processes:
            (lane,) = peers(checkout, called, SIZE, pause=1e6)(processes, [1])
            lane.radio.set(CELLS[cell])
            yield Row(f"at rest, {cell}", name, "B/s", [_bytes_per_second(lane.radio)])


def _bytes_per_second(radio: Radio, name: str = "") -> float:
    """Bytes per second of the whole radio, or to and from one end."""
    time.sleep(SETTLES)
    radio.reset()
    started = time.monotonic()
    time.sleep(AT_REST)
    flows = radio.counts().items()
    sent = sum(count.bytes for flow, count in flows if not name or name in (flow.source, flow.to))
    return sent / (time.monotonic() - started)


def _compared(case: str, starters: dict[str, Starter], samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """The contenders in sequence, each with its own lanes."""
    label = case
    for name, start in starters.items():
        tick(f"{case}, {name}")
        try:
            with Processes() as processes:
                lanes = start(processes, _seeds(cell, samples, LANES))
                yield Row(label, name, samples=collect(lanes, cell, samples, WARM_UP))
        except Exception as error:
            yield Row(case, name, error=sentence(error))
        else:
            label = ""


def _seeds(cell: str, samples: int, most: int) -> range:
    """The seeds of the lanes that are measured at a time, few enough that the processor is no bottleneck."""
    trip = 2 * CELLS[cell].link.delay
    most = min(most, LANES if trip >= FAST else FAST_LANES if trip else 1)
    return range(1, 1 + max(1, min(most, samples // SAMPLES_OF_A_LANE)))


def travellers(
    checkout: Checkout, processes: Processes, seeds: Sequence[int], *, over_zenoh: bool = False
) -> list[Lane]:
    """Start teams of two hosts with a coordinator that hops between them."""
    program = (_HERE / "radio_hops.L").read_text(encoding="utf-8")
    agents = f"//Post:near@{NEAR}", f"//Post:far@{FAR}", f"//Traveller:one@{NEAR}"
    prepared = Prepared(checkout, processes, program, agents)
    teams = [RadioTeam(prepared, seed, kept=False, over_zenoh=over_zenoh) for seed in seeds]
    return [Lane(team.radio, team.children[NEAR], "hops") for team in teams]


def peers(checkout: Checkout, name: str, size: int, pause: float = 0.0, *, fresh: bool = False) -> Starter:
    """Start a server and a client of radio_peers.py on each radio."""

    def start(processes: Processes, seeds: Sequence[int]) -> list[Lane]:
        keys = str(Keyring(processes.folder()).give("host") / "host")
        radios = [processes.keep(Radio(NEAR, FAR, seed=seed)) for seed in seeds]

        def children(robot: str, what: str, *arguments: str) -> list[Child]:
            """Start the children, then wait for a line of each: a client's first echo is not measured."""
            environment, command = checkout.environment, (checkout.python, _PEERS, what, name)
            lines = [r[robot].line((*command, r[FAR].address, keys, *arguments)) for r in radios]
            started = [processes.start(*line, environment=environment) for line in lines]
            for child in started:
                child.line(_TIMEOUT)
            return started

        children(FAR, "serve")
        clients = children(NEAR, "ask", str(size), str(pause), *(["fresh"] if fresh else []))
        return [Lane(radio, client, "echo") for radio, client in zip(radios, clients, strict=True)]

    return start


def vehicles(checkout: Checkout, processes: Processes, seeds: Sequence[int], hosts: int) -> list[RadioTeam]:
    """Start teams of hosts with a copter each that can be stopped."""
    names = range(hosts)
    fcs = "".join(f"\n  v{n}: {{devices: {{fc: {{{_COPTER}, system: {n + 1}}}}}}}" for n in names)
    agents = [*(f"//Vehicle:v{n}@h{n}" for n in names), "//Nobody:one@h0"]
    program = (_HERE / "radio_stops.L").read_text(encoding="utf-8")
    prepared = Prepared(checkout, processes, program, agents, f"silence: 2.0\nagents:{fcs}\n")
    teams = [RadioTeam(prepared, seed, kept=True) for seed in seeds]
    for team in teams:
        for child in team.children.values():
            until(child, "ready")
        team.radio.set(CELLS[MEANWHILE])
    time.sleep(ADAPTS)
    return teams


def stopping(
    checkout: Checkout, processes: Processes, seeds: Sequence[int], hosts: int, way: str
) -> list[StopLane]:
    """Start teams, each with a desk that stops it."""
    lanes = []
    for team in vehicles(checkout, processes, seeds, hosts):
        link = link_of_page(team) if way != "command" else ""
        words = ("page", PAUSE, link) if way == "page" else ("command", PAUSE, *team.mission)
        lanes.append(StopLane(team.radio, team.desk(_DESK, *words), "stop"))
    return lanes


def link_of_page(team: RadioTeam) -> str:
    """Start `lfield watch`; returns the link of its page."""
    line = until(team.watch(), "http")
    return next(word for word in line.split() if word.startswith("http"))


def until(child: Child, words: str) -> str:
    """Wait for a line with these words. Raises ChildError without one."""
    end = time.monotonic() + _TIMEOUT
    while time.monotonic() < end:
        if words in (line := child.line(_TIMEOUT)):
            return line
    raise ChildError(f"no line with '{words}' within {_TIMEOUT:g} s")
