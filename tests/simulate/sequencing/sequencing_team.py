"""A team whose boss starts, awaits and stops another coordinator, and a judge of both.

The judge is called after each event. A requested start is made at most once; no two copies of the started
coordinator run; and each request gets an answer, or an exception at its limit.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions, copies
from lfield.text import log_messages

HOSTS = ("alpha", "bravo", "carol")
PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal work(real seconds) { sleep(seconds); }
    portal home() { }
}
coordinator Patrol {
    Post[] all;
    private void at(int i, real seconds) {
        while (true) {
            try { all[i].work(seconds); return; }
            catch (RestartException e) { all = findPost(); }
            catch (UnreachableResourceException e) { sleep(1.0); }
        }
    }
    init(string[] arg) {
        print("patrol begins");
        all = findPost();
        for (int i = 0; i < all.length(); i += 1) at(i, 1.0);
        print("patrol has been everywhere");
    }
}
coordinator Boss {
    private string ended() {
        while (true) {
            try { return awaitEnd("patrol", 30.0); }
            catch (TimeLimitException e) { print("still waits"); }
            catch (RestartException e) { print("again"); }
        }
    }
    init(string[] arg) {
        int rounds = s2i(arg[1]);
        for (int i = 0; i < rounds; i += 1) {
            boolean asked = false;
            while (!asked) {
                try {
                    print("asks");
                    start("patrol", 20.0);
                    asked = true;
                }
                catch (TimeLimitException e) { print("not in time: " + e.message()); }
                catch (RestartException e) { print("restarted"); }
                catch (ReservedException e) { asked = true; print("runs already"); }
            }
            if (i % 2 == 1) {
                sleep(1.5);
                try { stop("patrol", 20.0); }
                catch (TimeLimitException e) { print("not stopped in time"); }
                catch (RestartException e) { print("restarted"); }
            }
            print("ended: " + ended());
        }
        print("boss is done");
    }
}
"""
DEPLOYMENT = """
//Post:p1@alpha
//Post:p2@bravo
//Post:p3@carol
//Boss:boss@alpha?{rounds}
startable Patrol:patrol@{home}
"""
_STARTED = re.compile(
    re.escape(log_messages.SEQUENCE_STARTED.line(agent="patrol", by="boss", generation=0)).replace(
        "0", r"(\d+)"
    )
)


class SequencingTeam:
    """The team, and the findings of the judge."""

    def __init__(
        self, folder: Path, seed: int, home: str = "bravo", rounds: int = 4, *, keeps: bool = True
    ) -> None:
        (folder / "mission.L").write_text(PROGRAM)
        (folder / "mission.dL").write_text(DEPLOYMENT.format(home=home, rounds=rounds))
        mission = load_mission(folder / "mission.dL")
        self.rng = random.Random(f"faults {seed}")
        self.fleet = Fleet(mission, seed, watch=self._judge, options=FleetOptions(keeps=keeps))

    def _judge(self, fleet: Fleet) -> None:
        running = [
            (generation, host)
            for (agent, generation), hosts in copies(fleet).items()
            if agent == "patrol"
            for host in hosts
        ]
        assert len(running) <= 1, f"{fleet.now:.3f}: two copies run: {running}"
        assert not fleet.failed, self.last_lines()

    def last_lines(self) -> str:
        return "\n".join(f"{at:8.3f} {host} {text.rstrip()}" for at, host, text in self.fleet.log[-60:])

    @property
    def starts(self) -> list[int]:
        """The numbers of the starts, in their order."""
        return [int(found[1]) for _, _, text in self.fleet.log if (found := _STARTED.search(text))]

    def count(self, text: str) -> int:
        return sum(text in line for _, _, line in self.fleet.log)

    def until(self, condition: Callable[[], bool], at_most: float) -> None:
        end = self.fleet.now + at_most
        while not condition():
            assert self.fleet.now < end, self.last_lines()
            self.fleet.run(0.5)

    def finish(self, at_most: float = 600.0) -> None:
        """Run until the boss has done all its rounds; assert that each start was requested and has ended."""
        self.until(lambda: self.count("boss is done") > 0, at_most)
        self.fleet.run(5.0)
        assert self.starts == sorted(set(self.starts)), self.last_lines()
        assert len(self.starts) <= self.count("boss: asks"), self.last_lines()
        assert self.count("patrol begins") >= len(self.starts)
        assert "patrol" not in {agent for agent, _ in copies(self.fleet)}, self.last_lines()


def run_scenario(folder: Path, seed: int, at_most: float = 600.0) -> None:
    """A team whose hosts crash and return, and whose links break; without faults it then finishes."""
    home = HOSTS[seed % 3]
    team = SequencingTeam(folder, seed, home, rounds=4)
    fleet, rng = team.fleet, team.rng
    fleet.run(1.0)
    for _ in range(12):
        fleet.run(rng.uniform(0.1, 4.0))
        host, other = rng.sample(HOSTS, 2)
        match rng.choice(("crash", "crash", "power", "cut")):
            case "crash" if host in fleet.runs:
                fleet.crash(host)
            case "power" if host in fleet.runs:
                fleet.power_off(host)
            case "cut":
                fleet.cut(host, other)
        fleet.run(rng.uniform(0.1, 6.0))
        fleet.heal(host, other)
        if host not in fleet.runs:
            fleet.boot(host)
    fleet.heal_all()
    team.finish(at_most)
