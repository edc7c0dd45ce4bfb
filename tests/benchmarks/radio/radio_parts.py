"""The parts of the figure of poor radio: hops, stops, outages, bytes at rest; each for one cell."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from emulator.cells import CELLS
from emulator.radio import Radio
from harness.checkout import Checkout
from harness.figure import Row
from harness.processes import Child, ChildError, Processes
from harness.samples import Tick, sentence
from harness.words import COUNT
from radio.radio_lanes import Lane, StopLane, collect, watch
from radio.radio_lanes import outages as outages_of
from radio.radio_team import DESK, RadioTeam

from lfield.testing.keys import Keyring

#: Lanes that are measured at a time: of long round trips, of short ones, and where only the processor counts.
LANES, FAST_LANES, LANES_OF_FIVE = 20, 8, 6
#: A lane that measures fewer is not worth its start.
SAMPLES_OF_A_LANE = 10
#: A round trip in s below which lanes keep a processor busy, and the size of a request in bytes.
FAST, SIZE = 0.09, 600
#: Bytes of a request that is as small as an order to stop.
ORDER = 150
#: Samples of a lane that are not counted: the connection learns its round trip.
WARM_UP = 10
#: The seconds of outages, lanes that have them at a time, and seconds between two of them.
OUTAGES, LANES_WITH_OUTAGES, BETWEEN = (1.0, 5.0, 15.0, 30.0), 6, 4.0
#: Seconds in which bytes at rest are counted.
AT_REST = 20.0
#: What is compared with a hop, and with a stop; `fresh` ones connect for every request.
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
#: Seconds that a team has until it runs.
_PATIENCE = 120.0
_COPTER = "driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog]"

#: Starts a lane, whose processes end with `Processes`, with the seed of its radio.
Starter = Callable[[Processes, int], Lane]


def hops(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """Two hops of a coordinator beside requests of the same size."""
    starters: dict[str, Starter] = {"lfield": lambda processes, seed: traveller(checkout, processes, seed)}
    starters |= {name: peer(checkout, called, SIZE) for name, called in PEERS.items()}
    yield from _compared(f"hops, {cell}", starters, samples, tick, cell)


def stops(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """A stop of teams of one and of five hosts, from the command and the page, beside small requests."""
    for hosts in (1, 5):
        for way in ("command", "command, watch open", "page"):
            case, shown = f"stop of {hosts}, {cell}", f"lfield, {way}"
            tick(f"{case}, {way}")
            try:
                yield from _stops(checkout, samples, cell, hosts, way)
            except Exception as error:
                yield Row(case, shown, error=sentence(error))
    starters = {
        name: peer(checkout, called, ORDER, fresh=fresh) for name, (called, fresh) in STOP_PEERS.items()
    }
    yield from _compared(f"stop, {cell}", starters, samples, tick, cell)


def _stops(checkout: Checkout, samples: int, cell: str, hosts: int, way: str) -> Iterator[Row]:
    with Processes() as processes:
        seeds = _seeds(cell, samples, LANES if hosts == 1 else LANES_OF_FIVE)
        lanes = [stopping(checkout, processes, seed, hosts, way) for seed in seeds]
        found = collect(lanes, cell, samples)
        sizes = [size / 1000 for lane in lanes for size in lane.sizes]
        yield Row(f"stop of {hosts}, {cell}", f"lfield, {way}", samples=found)
        yield Row("", "sent and received for it", "kB", sizes)
        if again := sum(len(lane.again) for lane in lanes):
            yield Row("", "not confirmed, pressed again", COUNT, [again])


def outages(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """How soon traffic continues after the path has returned; one outage per round and lane."""
    rounds = max(1, samples // 100)
    starters: dict[str, Starter] = {"lfield": lambda processes, seed: traveller(checkout, processes, seed)}
    starters |= {name: peer(checkout, called, SIZE, pause=0.1) for name, called in PEERS.items()}
    found: dict[tuple[float, str], list[float]] = {}
    with Processes() as processes:
        lanes: dict[str, list[Lane]] = {}
        for name, start in starters.items():
            tick(f"outages, {name}, made ready")
            lanes[name] = [start(processes, seed) for seed in _seeds(cell, samples, LANES_WITH_OUTAGES)]
        every = [lane for some in lanes.values() for lane in some]
        collect(every, cell, len(every))
        for number in range(rounds):
            for seconds in OUTAGES:
                tick(f"outages, {seconds:g} s, round {number + 1} of {rounds}")
                delays = outages_of(every, FAR, seconds)
                for name, some in lanes.items():
                    of_name = [delays[every.index(lane)] for lane in some]
                    found.setdefault((seconds, name), []).extend(of_name)
                rest(every, BETWEEN)
    for (seconds, name), delays in found.items():
        case = f"outage of {seconds:g} s, {cell}" if name == "lfield" else ""
        yield Row(case, name, samples=delays)


def rest(lanes: Sequence[Lane], seconds: float) -> None:
    """Let time pass, and take what is printed."""
    end = time.monotonic() + seconds
    watch(lanes, lambda: time.monotonic() >= end)


#: The robot at the other end of a lane's path.
NEAR, FAR = "h0", "h1"


def idle(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """Bytes per second and link of a team of five, of `watch` for each host, and of the standing peers."""
    tick(f"at rest, {cell}")
    with Processes() as processes:
        team = vehicles(checkout, processes, 1, 5)
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
            lane = peer(checkout, called, SIZE, pause=1e6)(processes, 1)
            lane.radio.set(CELLS[cell])
            yield Row(f"at rest, {cell}", name, "B/s", [_bytes_per_second(lane.radio)])


def _bytes_per_second(radio: Radio, name: str = "") -> float:
    """Of all, or of one end."""
    time.sleep(2.0)
    radio.reset()
    begun = time.monotonic()
    time.sleep(AT_REST)
    flows = radio.counts().items()
    sent = sum(count.bytes for flow, count in flows if not name or name in (flow.source, flow.to))
    return sent / (time.monotonic() - begun)


def _compared(case: str, starters: dict[str, Starter], samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """One contender after the other, each with lanes of its own."""
    shown = case
    for name, start in starters.items():
        tick(f"{case}, {name}")
        try:
            with Processes() as processes:
                lanes = [start(processes, seed) for seed in _seeds(cell, samples, LANES)]
                yield Row(shown, name, samples=collect(lanes, cell, samples, WARM_UP))
        except Exception as error:
            yield Row(case, name, error=sentence(error))
        else:
            shown = ""


def _seeds(cell: str, samples: int, most: int) -> range:
    """Of the lanes that are measured at a time: so few that a processor is not what is measured."""
    trip = 2 * CELLS[cell].link.delay
    most = min(most, LANES if trip >= FAST else FAST_LANES if trip else 1)
    return range(1, 1 + max(1, min(most, samples // SAMPLES_OF_A_LANE)))


def traveller(checkout: Checkout, processes: Processes, seed: int) -> Lane:
    """Two hosts, and a coordinator that hops from the one to the other; nothing waits for a disk."""
    program = (_HERE / "radio_hops.L").read_text(encoding="utf-8")
    agents = f"//Post:near@{NEAR}", f"//Post:far@{FAR}", f"//Traveller:one@{NEAR}"
    team = RadioTeam(checkout, processes, program, agents, seed=seed, kept=False)
    return Lane(team.radio, team.children[NEAR], "hops")


def peer(checkout: Checkout, name: str, size: int, pause: float = 0.0, *, fresh: bool = False) -> Starter:
    """A server and a client of radio_peers.py."""

    def start(processes: Processes, seed: int) -> Lane:
        keys = str(Keyring(processes.folder()).give("host") / "host")
        radio = processes.keep(Radio(NEAR, FAR, seed=seed))
        at = name, radio[FAR].address, keys
        words = {
            FAR: (checkout.python, _PEERS, "serve", *at),
            NEAR: (checkout.python, _PEERS, "ask", *at, str(size), str(pause), *(["fresh"] if fresh else [])),
        }
        environment = checkout.environment
        children = {}
        for robot, line in words.items():
            children[robot] = processes.start(*radio[robot].line(line), environment=environment)
            children[robot].line(_PATIENCE)
        return Lane(radio, children[NEAR], "echo")

    return start


def vehicles(checkout: Checkout, processes: Processes, seed: int, hosts: int) -> RadioTeam:
    """Hosts with a copter each."""
    names = range(hosts)
    fcs = "".join(f"\n  v{n}: {{devices: {{fc: {{{_COPTER}, system: {n + 1}}}}}}}" for n in names)
    agents = [*(f"//Vehicle:v{n}@h{n}" for n in names), "//Nobody:one@h0"]
    program = (_HERE / "radio_stops.L").read_text(encoding="utf-8")
    team = RadioTeam(checkout, processes, program, agents, f"silence: 2.0\nagents:{fcs}\n", seed=seed)
    for host in team.hosts:
        until(team.children[host], "ready")
    return team


def stopping(checkout: Checkout, processes: Processes, seed: int, hosts: int, way: str) -> StopLane:
    """A team and a desk that stops it."""
    team = vehicles(checkout, processes, seed, hosts)
    link = link_of_page(team) if way != "command" else ""
    words = ("page", "1.0", link) if way == "page" else ("command", "1.0", str(team.bundle), *team.maps)
    return StopLane(team.radio, team.desk(_DESK, *words), "stop")


def link_of_page(team: RadioTeam) -> str:
    """Open `lfield watch`."""
    line = until(team.watch(), "http")
    return next(word for word in line.split() if word.startswith("http"))


def until(child: Child, words: str) -> str:
    """The first line that has these words. Raises ChildError."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        if words in (line := child.line(_PATIENCE)):
            return line
    raise ChildError(f"no line with '{words}' within {_PATIENCE:g} s")
