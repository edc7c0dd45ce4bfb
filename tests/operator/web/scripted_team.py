"""A scripted team: the view a follower would have of copters in circles and a coordinator between them. Run
as a program it serves the page of that team; words on its stdin change it (`Script.do`).
"""

from __future__ import annotations

import argparse
import asyncio
import math
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from lfield.capability.offer import Fact, Offer
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import SystemClock
from lfield.errors import AddressError
from lfield.operator.dashboard.operator_actions import OrderKind, OrderOutcome, QueryAnswer
from lfield.operator.team_model.command_log import CommandLog
from lfield.operator.team_model.curve_history import CurveHistory
from lfield.operator.team_model.team_state import (
    AgentState,
    Curve,
    DeviceState,
    GeoPosition,
    HopState,
    HostState,
    LinkState,
    LocalPosition,
    OfferState,
    OrderState,
    ShownLogLine,
    StopState,
    TeamState,
    TelemetryReading,
    TrackUpdate,
    VehicleState,
)
from lfield.operator.team_model.vehicle_tracks import TeamTracks
from lfield.operator.team_query import PrimitiveAnswer
from lfield.vm.waits.operator_input import NO_READER
from lfield.wire.observer_messages import EmergencyStopResult

#: Degrees of latitude in a metre.
METRE = 1 / 111_320.0


@dataclass
class Script:
    """So many copters, each on a host of its own; `now` is a monotonic clock (s)."""

    count: int
    earth: bool = False
    now: object = time.monotonic
    dead: set[str] = field(default_factory=set)
    unplaced: set[str] = field(default_factory=set)
    stubborn: set[str] = field(default_factory=set)
    # : Hosts that hang: they are linked, and do not answer.
    hung: set[str] = field(default_factory=set)
    denied_orders: dict[OrderKind, str] = field(default_factory=dict)
    # : Hosts with which no link is possible, each with the reason.
    refused: dict[str, str] = field(default_factory=dict)
    stopped: float | None = None
    paused: bool = False
    # : Hosts that the vote on an activation holds.
    voting: set[str] = field(default_factory=set)
    #: The agents of each host that wait for a line of input.
    reading: dict[str, list[str]] = field(default_factory=dict)
    pressed: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.began = self.now()
        self.presses = CommandLog()
        self.held: set[str] = set()
        self.reason = "the emergency stop was pressed"
        self.low: set[str] = set()
        self.places: dict[str, tuple[float, float]] = {}
        self.frozen = {}
        self.lines: list[ShownLogLine] = []
        self.revision = 0
        self.track_log = TeamTracks()

    # --- commands -------------------------------------------------------------------------------

    def do(self, words: list[str]) -> None:
        match words:
            case ["kill", host]:
                self.dead.add(host)
                self.frozen[host] = self.now()
            case ["hang", host]:
                self.hung.add(host)
            case ["place", agent, north, east]:
                self.places[agent] = float(north), float(east)
            case ["unplace", agent]:
                self.unplaced.add(agent)
            case ["stubborn", agent]:
                self.stubborn.add(agent)
            case ["bar", order, *why]:
                self.denied_orders[order] = " ".join(why)
            case ["latch", agent]:
                self.stubborn.discard(agent)
                self.stopped = self.now()
                self.held |= {self.host_of(number) for number in range(self.count)} - self.dead
            case ["vote", host]:
                self.voting.add(host)
            case ["read", host, *agents]:
                self.reading[host] = agents
            case ["low", agent]:
                self.low.add(agent)
            case ["refuse", host, *reason]:
                self.refused[host] = " ".join(reason)
            case ["say", host, *text]:
                self.say(host, " ".join(text))
            case ["count", host, many]:
                for number in range(int(many)):
                    self.say(host, f"line {number}")
                print("counted", flush=True)

    def say(self, host: str, text: str, agent: str = "") -> None:
        self.lines.append(ShownLogLine(len(self.lines) + 1, host, time.time(), 0.0, agent, text))

    # --- Actions --------------------------------------------------------------------------------

    async def stop(self, reason: str = "") -> OrderOutcome:
        self.reason = f"the emergency stop was pressed: {reason}"
        self.stopped = self.now()
        self.held |= self.order("stop")
        self.pressed.append("stop")
        print("pressed stop", flush=True)
        return OrderOutcome("stop")

    def order(self, order: OrderKind) -> set[str]:
        """The hosts that receive it."""
        names = [self.host_of(number) for number in range(self.count)]
        number = self.presses.on_order(order, names, self.now())
        for name in set(names) - self.hung:
            refused = AddressError(f"{name}:8181", "no program listens there")
            self.presses.on_answer(number, name, refused if name in self.dead else EmergencyStopResult({}))
        return set(names) - self.dead - self.hung

    async def lift(self) -> OrderOutcome:
        self.held -= self.order("lift")
        self.stopped = self.stopped if self.held else None
        print("pressed lift", flush=True)
        return OrderOutcome("lift")

    async def pause(self) -> OrderOutcome:
        self.paused = True
        self.order("pause")
        print("pressed pause", flush=True)
        return OrderOutcome("pause")

    async def resume(self) -> OrderOutcome:
        self.paused = False
        self.order("resume")
        print("pressed resume", flush=True)
        return OrderOutcome("resume")

    async def enter(self, host: str, agent: str, text: str) -> str:
        if agent not in self.reading.get(host, []) or text == "too late":
            return NO_READER.format(agent=agent)
        self.reading[host].remove(agent)
        print(f"entered {host} {agent} {text}", flush=True)
        return ""

    async def query(self, text: str) -> QueryAnswer:
        if text == "Lift":
            offers = [
                Offer("Lift", "direct", "lift", v.agent, v.host, 1.0, {"payload": Fact(2.5)})
                for v in self.snapshot().vehicles.values()
            ]
            return QueryAnswer(
                text, (PrimitiveAnswer(read_registry().primitives["Lift"], offers, len(offers), (), ()),)
            )
        return QueryAnswer(text, mistakes=f'error: nobody knows what "{text}" is')

    # --- State ----------------------------------------------------------------------------------

    def host_of(self, number: int) -> str:
        return ("alpha", "bravo")[number] if self.count <= 2 else f"robot{number + 1}"

    def agent_of(self, number: int) -> str:
        return ("lead", "wing")[number] if self.count <= 2 else f"copter{number + 1}"

    def vehicle(self, number: int) -> VehicleState:
        host, agent = self.host_of(number), self.agent_of(number)
        now = self.frozen.get(host, self.now())
        seconds = now - self.began
        angle = 0.25 * seconds * (1 if number % 2 else -1) + number
        radius = 6.0 + 2.4 * number
        north, east = self.places.get(agent, (radius * math.cos(angle), radius * math.sin(angle)))
        height = 3.0 + number % 7 + 0.4 * math.sin(seconds)
        held = self.stopped is not None and host in self.held
        latched = held and agent not in self.stubborn
        device = DeviceState(
            f"{agent}.fc",
            agent,
            host,
            host not in self.dead,
            True,
            "the emergency stop was pressed" if held else "",
            latched,
            "" if latched and self.now() - (self.stopped or 0) > 1.5 else "descends at 0.8 m/s",
            0.1,
            {"position": TelemetryReading([1.0, 2.0, 3.0], 0.1)},
        )
        placed = agent not in self.unplaced
        return VehicleState(
            agent,
            "Copter",
            host,
            host not in self.dead,
            LocalPosition(north, east, -height) if placed else None,
            GeoPosition(47.4 + north * METRE, 8.5 + east * METRE / math.cos(math.radians(47.4)))
            if placed and self.earth
            else None,
            0.1,
            False,
            (angle + (math.pi / 2 if number % 2 else -math.pi / 2)) % (2 * math.pi),
            1.5,
            height,
            max(0.0, 0.95 - 0.001 * seconds - 0.015 * number),
            "GUIDED",
            True,
            0.15 + self.now() - now,
            "",
            (device,),
            GeoPosition(47.4, 8.5) if self.earth else None,
            40.0 if self.earth else None,
            10.0 if self.earth else None,
        )

    def snapshot(self) -> TeamState:
        self.revision += 1
        seconds = self.now() - self.began
        names = [self.host_of(number) for number in range(self.count)]
        vehicles = {self.agent_of(number): self.vehicle(number) for number in range(self.count)}
        self.track_log.add(vehicles.values())
        live = [name for name in names if name not in self.dead]
        hosts = {
            name: HostState(
                name,
                name in live,
                "" if name in live else "no program listens there",
                0.1 if name in live else self.now() - self.frozen[name],
                seconds,
                paused=self.paused,
                held_by_vote=name in self.voting,
                stopped="stop" if name in self.held else "",
                waits_for=tuple(self.refused),
                awaiting_input=tuple(self.reading.get(name, [])),
                refused=self.refused,
                bundle="5cde09b1f2a37c44",
                links={
                    other: LinkState(0.0431, 0.048, 12_300, 9_100)
                    for other in [other for other in live if other != name][:3]
                    if name in live
                },
            )
            for name in names
        }
        hop = int(seconds / 2.0)
        at = [names[(hop + n) % len(names)] for n in range(2)]
        trail = tuple(
            HopState(
                n,
                names[(n - 1) % len(names)],
                names[n % len(names)],
                seconds - 2.0 * n,
                vehicles and next(iter(vehicles)),
                "fly",
                620,
                0.0009,
            )
            for n in range(max(1, hop - 4), hop + 1)
        )
        pilot = AgentState(
            "pilot",
            "FirstFlight",
            "coordinator",
            at[0],
            at[0] in live,
            0.1,
            1,
            hop,
            0,
            "",
            "waits",
            "mission.L",
            42 + hop % 5,
            "wing.fly" if hop % 2 else "lead.fly",
            trail=trail,
        )
        if int(seconds) > len([line for line in self.lines if line.agent]):
            self.say(at[0], f"at {vehicles[self.agent_of(hop % self.count)].height:.1f} m", "pilot")
        orders = self.presses.snapshot(self.now(), hosts, {})
        return TeamState(
            "mission",
            self.revision,
            hosts,
            vehicles,
            {"pilot": pilot},
            {
                name: OfferState(
                    name, "Copter", v.host, "" if v.fresh else f"{v.host} is not reached", v.fresh
                )
                for name, v in vehicles.items()
            },
            self.stop_seen(vehicles, hosts, orders),
            tuple(self.lines),
            orders,
        )

    def stop_seen(
        self, vehicles: dict[str, VehicleState], hosts: dict[str, HostState], orders: tuple[OrderState, ...]
    ) -> StopState:
        if self.stopped is None:
            return StopState()
        devices = [
            device for vehicle in vehicles.values() for device in vehicle.devices if device.host in self.held
        ]
        fresh_devices = [device for device in devices if device.fresh]
        pending = next((order.pending for order in orders if order.order == "stop"), ())
        return StopState(
            self.reason,
            "anna",
            self.now() - self.stopped,
            tuple(name for name, host in hosts.items() if host.stopped and host.linked),
            tuple(device.name for device in fresh_devices if device.confirmed),
            {device.name: "it has not answered" for device in fresh_devices if not device.confirmed},
            {name: host.problem for name, host in hosts.items() if not host.linked and not host.stopped},
            pending,
            {device.host: (device.name,) for device in devices if not device.fresh},
        )

    def tracks(self, after: int) -> TrackUpdate:
        return self.track_log.since(after)

    def curves(self) -> tuple[Curve, ...]:
        """The curves of the last five minutes, as the product has them."""
        now, curves = self.now(), CurveHistory()
        for ago in range(300, -1, -5):
            seconds = now - self.began - ago
            vehicles = {}
            for number in range(self.count):
                vehicle = self.vehicle(number)
                vehicles[vehicle.agent] = replace(
                    vehicle,
                    height=None if vehicle.agent in self.low else 3 + number % 7 + math.sin(seconds / 9),
                    battery=0.6 - 0.0005 * seconds - 0.01 * number,
                    telemetry_age=0.1 + 0.1 * abs(math.sin(seconds * (number + 1))),
                )
            curves.add(now - ago, vehicles, {"pilot": 30 + 4 * math.sin(seconds / 20)})
        return curves.snapshot(now)


async def main() -> None:
    from lfield.authority.web_ca.web_keys import read_web_keys
    from lfield.operator.dashboard.map_files import file_drawings
    from lfield.operator.web.page_server import ServedPage, serve
    from lfield.operator.web.page_site import local_site, network_site
    from lfield.operator.web.tiles.background import PageBackground, open_background

    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--earth", action="store_true")
    parser.add_argument("--tiles")
    parser.add_argument("--draw", type=Path, nargs="*", default=[])
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--listen")
    parser.add_argument("--page-keys", type=Path)
    args = parser.parse_args()
    script = Script(args.count, args.earth)
    loop = asyncio.get_running_loop()

    def read() -> None:
        for line in sys.stdin:
            loop.call_soon_threadsafe(script.do, line.split())

    threading.Thread(target=read, daemon=True).start()
    background = PageBackground(open_background(args.tiles) if args.tiles else None, file_drawings(args.draw))
    served = ServedPage("first-flight", script, script, SystemClock(), background)
    if args.listen is None:
        site = await local_site(args.port, print)
    else:
        site = await network_site(args.listen, args.port, read_web_keys(args.page_keys), print)
    await serve(served, site, lambda link: print(link, flush=True))


if __name__ == "__main__":
    asyncio.run(main())
