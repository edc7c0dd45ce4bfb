"""Stories: a team, a mission and a forecast, all drawn from one seed, and small enough to be told quickly.

The mission says by itself what it does: resources write down every call that they begin and end, coordinators
what became of it, and devices are told who moves them. So nobody has to ask the code that is being tried.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from lfield.bytecode.program import Program
from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.weather import Fault, Weather

#: Every start of a coordinator draws a number; with its name that is its *life*.
PROGRAM = """
resource Post {
    int begun;
    init(string[] arg) { begun = 0; }
    portal stamp(string life, int number, real seconds) {
        write("begin " + life + " " + i2s(number) + "\\n");
        begun = begun + 1;
        sleep(seconds);
        write("end " + life + " " + i2s(number) + "\\n");
    }
    portal look() emit int { return begun; }
}
resource Arm {
    Mavlink fc;
    init(string[] arg) { }
    portal drive(string life, int drawn, int number) {
        write("begin " + life + " " + i2s(number) + "\\n");
        fc.release();
        fc.setVelocity(i2f(drawn), i2f(number), 0.0);
        sleep(0.2);
        fc.hold();
        write("end " + life + " " + i2s(number) + "\\n");
    }
}
coordinator Walker {
    init(string[] arg) {
        int drawn = random(1000000000);
        string life = arg[0] + "." + i2s(drawn);
        print("born " + life);
        Post[] posts = findPost();
        Arm[] arms = findArm();
        int all = posts.length() + arms.length();
        int at = 0;
        int number = 0;
        while (number != s2i(arg[1])) {
            if (random(4) != 0) at = random(all);
            number = number + 1;
            try {
                if (at < posts.length()) {
                    posts[at].stamp(life, number, s2f(arg[2]));
                } else {
                    arms[at - posts.length()].drive(life, drawn, number);
                }
                print("done " + life + " " + i2s(number));
            } catch (UnreachableResourceException gone) {
                print("failed " + life + " " + i2s(number));
            } catch (RestartException again) {
                print("restarted " + life + " " + i2s(number) + " " + again.message());
            } catch (Exception other) {
                print("threw " + life + " " + i2s(number));
            }
            try {
                if (random(4) == 0) posts[random(posts.length())].look();
            } catch (Exception other) { }
            sleep(0.02 + 0.1 * random());
        }
        print("over " + life);
    }
}
"""
_PROGRAMS: dict[bytes, Program] = {}
#: What a walker does that never ends.
FOR_EVER = -1
#: Seconds between two faults of a kind at least and at most, and how likely each kind is in a story.
BETWEEN, LIKELY = (0.7, 6.0), 0.35
#: So many stories are of hosts that keep journals; the others forget, as many a trial does.
KEEP = 0.75
#: Seconds that a disk takes: one of a laptop, and one of a small board on a memory card.
DISKS = (0.002, 0.002, 0.05)


@dataclass(frozen=True, slots=True)
class Story:
    """All that a run depends on. Times are in seconds; `lost_after` None for walkers that walk for ever.

    Walkers make so many `calls`, FOR_EVER for no end, each of which lets them `stay` so long. Hosts keep
    `journals`, on disks that take `sync` to keep anything, or forget. The forecast is drawn for a team of
    `cast` hosts and `weather` seconds; `keep` has the numbers of its faults that strike, None for all.
    `hosts` and `seconds` are what is left when a story is made smaller.
    """

    seed: int
    cast: int
    weather: float
    hosts: int
    walkers: int
    arms: int
    calls: int
    stay: float
    seconds: float
    unreachable_after: float
    lost_after: float | None
    means: Mapping[str, float]
    journals: bool
    sync: float
    keep: frozenset[int] | None = None

    @property
    def mission(self) -> Mission:
        """Its mission; stories of one shape share it."""
        return _mission(self.hosts, self.walkers, self.arms, self.calls, self.stay)

    @property
    def forecast(self) -> list[Fault]:
        """The faults that strike."""
        return [fault for _, fault in self.numbered if {fault.one, fault.other} <= self._names(self.hosts)]

    @property
    def numbered(self) -> list[tuple[int, Fault]]:
        """The faults that are kept, with their numbers."""
        cast = sorted(self._names(self.cast))
        faults = Weather(**self.means).forecast(cast, random.Random(self.seed), self.weather)
        return [(n, fault) for n, fault in enumerate(faults) if self.keep is None or n in self.keep]

    def _names(self, hosts: int) -> set[str]:
        return {f"h{n}" for n in range(hosts)}


def drawn(seed: int) -> Story:
    """The story of a seed."""
    dice = random.Random(f"story {seed}")
    hosts = dice.choice((3, 3, 3, 4, 4, 5, 6, 7))
    ends = dice.random() < 0.25
    arms = dice.choice((0, 0, 0, 1, 1, 2))
    means = {
        kind: dice.uniform(*BETWEEN)
        for kind in Weather.__dataclass_fields__
        if dice.random() < LIKELY and (arms or not kind.startswith("guard"))
    }
    seconds = dice.uniform(4.0, 10.0)
    return Story(
        seed,
        hosts,
        seconds,
        hosts,
        dice.randint(1, 3),
        arms,
        dice.choice((6, 12)) if ends else FOR_EVER,
        dice.choice((0.04, 1.0)),
        seconds,
        dice.choice((0.5, 1.5, 3.0, 5.0)),
        dice.uniform(2.0, 5.0) if ends else None,
        means,
        dice.random() < KEEP,
        dice.choice(DISKS),
    )


@lru_cache(maxsize=256)
def _mission(hosts: int, walkers: int, arms: int, calls: int, stay: float) -> Mission:
    lines = [f"//Post:p{n}@h{n}" for n in range(hosts)]
    lines += [f"//Arm:a{n}@h{hosts - 1 - n}" for n in range(arms)]
    lines += [f"//Walker:w{n}@h{n % hosts}?{calls}&{stay}" for n in range(walkers)]
    with tempfile.TemporaryDirectory(prefix="lfield-story-") as folder:
        deployment = Path(folder) / "story.dL"
        deployment.with_suffix(".L").write_text(PROGRAM, encoding="utf-8")
        deployment.write_text("\n".join([*lines, ""]), encoding="utf-8")
        mission = load_mission(deployment, simulate=True)
    # What hosts prepare of a program is as large as they are: one program is enough.
    return replace(mission, program=_PROGRAMS.setdefault(mission.program.digest, mission.program))
