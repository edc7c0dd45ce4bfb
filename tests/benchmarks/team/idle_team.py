"""An idle team on simulated computers, for the figure `traffic`.

    idle_team.py HOSTS SECONDS [fenced]

prints messages and bytes of a host each second, the processor seconds of the team's start, and the processor
seconds of each second of virtual time. With `fenced` the team has a waiting coordinator that a majority of
the hosts, at most nine, can recover.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

from lfield.mission.bindings import MAX_MEMBERS
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed_link
from lfield.simulate.host_fleet import Fleet
from lfield.wire.messages import Message

#: Seconds of virtual time for the start of a team.
SETTLE = 10.0
_PROGRAM = "resource Post { init(string[] arg) { } portal stay() { } }\n"
_MEMBERS = [f"host{n}" for n in range(MAX_MEMBERS)]
_FENCED = """coordinator Waits {
    init(string[] arg) {
        heartbeatInterval(3.0);
        Post post = findPost()[0];
        while (true) { post.stay(); sleep(60.0); }
    }
}
"""


def mission(hosts: int, *, fenced: bool = False) -> Mission:
    """A team with a resource on each host; `fenced` adds a coordinator under leases."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "idle.L").write_text(_PROGRAM + _FENCED * fenced)
        posts = "".join(f"//Post:post{n}@host{n}\n" for n in range(hosts))
        (folder / "idle.dL").write_text(posts + "//Waits:w@host0\n" * fenced)
        if fenced:
            members = f"recovery: {{members: [{', '.join(_MEMBERS[:hosts])}]}}\n"
            (folder / "idle.devices.yaml").write_text(members)
        return load_mission(folder / "idle.dL")


def main() -> None:
    """Measure one team."""
    hosts, seconds = int(sys.argv[1]), float(sys.argv[2])
    team = mission(hosts, fenced="fenced" in sys.argv[3:])
    messages = sent = 0
    encoded = framed_link.encode

    def encode(message: Message) -> bytes:
        nonlocal messages, sent
        data = encoded(message)
        messages, sent = messages + 1, sent + len(data)
        return data

    with mock.patch.object(framed_link, "encode", encode):
        started = time.process_time()
        fleet = Fleet(team, 1)
        fleet.run(SETTLE)
        up = time.process_time()
        messages = sent = 0
        fleet.run(seconds)
        elapsed = time.process_time() - up
    print(messages / hosts / seconds, sent / hosts / seconds, up - started, elapsed / seconds, flush=True)


if __name__ == "__main__":
    main()
