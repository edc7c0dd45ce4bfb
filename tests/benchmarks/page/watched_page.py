"""The page of a team of so many vehicles at Unix sockets of a folder: `watched_page.py FOLDER N`.

All that `lfield watch` has: a link to each host and the follower behind it, the picture, the server. Prints
its link.
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


class NobodyActs:
    """No button is pressed."""

    denied_orders: dict[str, str] = {}


async def main(folder: str, count: int) -> None:
    """Serve until killed."""
    hosts = tuple(f"h{number}" for number in range(count))
    agents = {f"v{n}": TeamEntry(f"v{n}", "Copter", f"h{n}", "resource") for n in range(count)}
    agents["pilot"] = TeamEntry("pilot", "Pilot", "h0", "coordinator")
    roll = TeamContents("bench", hosts, agents, {f"v{n}.fc": Instruments(moves=True) for n in range(count)})
    clock = SystemClock()
    shown = TeamWatch(roll, clock)

    async def reach(host: str) -> str:
        return f"unix:{folder}/{host}.sock"

    page = ServedPage("bench", shown, NobodyActs(), clock)  # type: ignore[arg-type]
    await asyncio.gather(
        serve(page, await local_site(0, print), lambda link: print(link, flush=True)),
        shown.tick(),
        EventFollower(observer_transport(), hosts, reach, shown, clock, FollowOptions(telemetry=RATE)).run(),
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
