"""The page of a team of so many vehicles at Unix sockets of a folder: `watched_page.py FOLDER N`.

All that `lfield watch` has: a link to each host and the follower behind it, the picture, the server. Prints
its link.
"""

from __future__ import annotations

import asyncio
import sys

from lfield.clock import SystemClock
from lfield.operator.ask import observer
from lfield.operator.sight.following.follower import Follower
from lfield.operator.sight.picture.places import Instruments
from lfield.operator.sight.picture.roll import Enrolled, Roll
from lfield.operator.sight.watched import RATE, Watched
from lfield.operator.web.server import Served, serve
from lfield.operator.web.site import on_this_computer


class NobodyActs:
    """No button is pressed."""

    barred: dict[str, str] = {}


async def main(folder: str, count: int) -> None:
    """Serve until killed."""
    hosts = tuple(f"h{number}" for number in range(count))
    agents = {f"v{n}": Enrolled(f"v{n}", "Copter", f"h{n}", "resource") for n in range(count)}
    agents["pilot"] = Enrolled("pilot", "Pilot", "h0", "coordinator")
    roll = Roll("bench", hosts, agents, {f"v{n}.fc": Instruments(moves=True) for n in range(count)})
    clock = SystemClock()
    shown = Watched(roll, clock)

    async def reach(host: str) -> str:
        return f"unix:{folder}/{host}.sock"

    page = Served("bench", shown, NobodyActs(), clock)  # type: ignore[arg-type]
    await asyncio.gather(
        serve(page, await on_this_computer(0, print), lambda link: print(link, flush=True)),
        shown.tick(),
        Follower(observer(), hosts, reach, shown, clock, telemetry=RATE).run(),
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
