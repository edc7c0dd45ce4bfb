"""A coordinator that hops and then rests, on simulated computers, for the figure `leases`.

    leased_team.py volatile|kept|leased HOSTS SECONDS

prints messages and commits of a hop, then messages and bytes of a host each second while the coordinator
rests. With `leased` a quorum of hosts can recover the coordinator.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

from lfield.journal.journal import Change
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed_link
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.simulate.journal_disk import JournalDisk
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import Message

HOPS = 400
#: The most hosts that give leases.
MEMBERS = 9
#: Seconds of virtual time from the last hop until a team is at rest.
SETTLE = 15.0
#: The messages of a hop. All others are also sent at rest.
OF_HOPS = ("Transfer", "TransferAccepted", "TransferRefused", "TransferQuery")
_PROGRAM = """
resource Post { init(string[] arg) { } portal visit() { } portal say(string what) { write(what + "\\n"); } }
coordinator Traveller {
    init(string[] arg) {
        LEASED
        Post near = findPost("post0");
        Post far = findPost("post1");
        far.visit();
        near.say("begins");
        for (int i = 0; i < HOPS; i = i + 2) {
            far.visit();
            near.visit();
        }
        near.say("rests");
        sleep(10000.0);
    }
}
"""


class Counted:
    """Counts of the messages, bytes and commits of all hosts together."""

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        self.sent = self.commits = 0
        self._encode, self._transfer, self._write = (
            framed_link.encode,
            framed_link.encode_transfer,
            JournalDisk.write,
        )

    def begin(self) -> None:
        """Reset the counts."""
        self.messages.clear()
        self.sent = self.commits = 0

    def encode(self, message: Message) -> bytes:
        """Count a sent message."""
        data = self._encode(message)
        self.messages[type(message).__name__] += 1
        self.sent += len(data)
        return data

    def transfer(self, header: Transfer, block: Buffer) -> bytes:
        """Count a sent coordinator."""
        head = self._transfer(header, block)
        self.messages["Transfer"] += 1
        self.sent += len(head) + len(block)
        return head

    def write(self, disk: JournalDisk, changes: Sequence[Change], now: float) -> None:
        """Count a commit."""
        self.commits += 1
        self._write(disk, changes, now)


def mission(hosts: int, leased: bool) -> Mission:
    """A team with a resource on each host and a coordinator."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = _PROGRAM.replace("HOPS", str(HOPS))
        (folder / "team.L").write_text(text.replace("LEASED", "heartbeatInterval(3.0);" if leased else ""))
        rows = [f"//Post:post{n}@host{n}\n" for n in range(hosts)]
        (folder / "team.dL").write_text("".join([*rows, "//Traveller:traveller@host0\n"]))
        names = ", ".join(f"host{n}" for n in range(min(hosts, MEMBERS)))
        (folder / "team.devices.yaml").write_text(f"recovery: {{members: [{names}]}}\n")
        return load_mission(folder / "team.dL")


def run_until(fleet: Fleet, word: str) -> None:
    """Run until the mission prints `word`."""
    while not any(text.strip() == word for _, _, text in fleet.log):
        fleet.run(0.01)


def main() -> None:
    """Measure one team."""
    kind, hosts, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    counted, team = Counted(), mission(hosts, kind == "leased")
    with (
        mock.patch.object(framed_link, "encode", counted.encode),
        mock.patch.object(framed_link, "encode_transfer", counted.transfer),
        mock.patch.object(JournalDisk, "write", lambda *words: counted.write(*words)),
    ):
        fleet = Fleet(team, 1, options=FleetOptions(keeps=kind != "volatile"))
        run_until(fleet, "begins")
        counted.begin()
        run_until(fleet, "rests")
        print(sum(counted.messages[name] for name in OF_HOPS) / HOPS, counted.commits / HOPS)
        fleet.run(SETTLE)
        counted.begin()
        fleet.run(seconds)
        each = hosts * seconds
        print(counted.messages.total() / each, counted.sent / each, flush=True)


if __name__ == "__main__":
    main()
