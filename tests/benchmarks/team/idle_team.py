"""A team in which nothing happens, on simulated computers, for the figure `traffic`.

    idle_team.py HOSTS SECONDS

prints what a host sends each second (messages, bytes), and the seconds of a processor that starting the team
took, and then each second of virtual time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed
from lfield.simulate.fleet import Fleet
from lfield.wire.messages import Message

#: Seconds of virtual time in which a team comes up.
SETTLE = 10.0
_PROGRAM = "resource Post { init(string[] arg) { } portal stay() { } }\n"


def mission(hosts: int) -> Mission:
    """A team of so many, with a resource on each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "idle.L").write_text(_PROGRAM)
        (folder / "idle.dL").write_text("".join(f"//Post:post{n}@host{n}\n" for n in range(hosts)))
        return load_mission(folder / "idle.dL")


def main() -> None:
    """Measure one team."""
    hosts, seconds = int(sys.argv[1]), float(sys.argv[2])
    team = mission(hosts)
    messages = sent = 0
    encoded = framed.encode

    def encode(message: Message) -> bytes:
        nonlocal messages, sent
        data = encoded(message)
        messages, sent = messages + 1, sent + len(data)
        return data

    with mock.patch.object(framed, "encode", encode):
        began = time.process_time()
        fleet = Fleet(team, 1)
        fleet.run(SETTLE)
        up = time.process_time()
        messages = sent = 0
        fleet.run(seconds)
        took = time.process_time() - up
    print(messages / hosts / seconds, sent / hosts / seconds, up - began, took / seconds, flush=True)


if __name__ == "__main__":
    main()
