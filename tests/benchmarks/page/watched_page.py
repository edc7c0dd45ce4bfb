"""The page of a team of N vehicles at Unix sockets of a folder: `watched_page.py FOLDER N`.

All parts of `lfield watch`: a link and an event follower for each host, the team model, the server. Prints
the link of the page.
"""

from __future__ import annotations

import asyncio
import sys

from lfield.client.team_watch import RATE, TeamWatch
from lfield.clock import SystemClock
from lfield.operator.client import observer_transport
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.vehicle_readings import Instruments
from lfield.operator.web.page_server import ServedPage, serve
from lfield.operator.web.page_site import local_site


class NoOrders:
    """The orders of a page on which no button is pressed."""

    denied_orders: dict[str, str] = {}


async def main(folder: str, count: int) -> None:
    """Serve until killed."""
    hosts = tuple(f"h{number}" for number in range(count))
    agents = {f"v{n}": TeamEntry(f"v{n}", "Copter", f"h{n}", "resource") for n in range(count)}
    agents["pilot"] = TeamEntry("pilot", "Pilot", "h0", "coordinator")
    roll = TeamContents(
        "bench", hosts, agents, {f"v{n}.fc": Instruments(has_safe_state=True) for n in range(count)}
    )
    clock = SystemClock()
    watch = TeamWatch(roll, clock)

    async def reach(host: str) -> str:
        return f"unix:{folder}/{host}.sock"

    page = ServedPage("bench", watch, NoOrders(), clock)  # type: ignore[arg-type]
    await asyncio.gather(
        serve(page, await local_site(0, print), lambda link: print(link, flush=True)),
        watch.tick(),
        EventFollower(observer_transport(), hosts, reach, watch, clock, FollowOptions(telemetry=RATE)).run(),
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
