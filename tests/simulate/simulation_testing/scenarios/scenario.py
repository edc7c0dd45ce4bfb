"""Scenarios: a team, a mission and a forecast, all drawn from one seed, and small enough to run quickly.

The mission reports its actions: resources print the start and end of every call, coordinators its outcome,
and the commands of devices identify their caller. So the checks do not depend on the tested code.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from msgspec import structs

from lfield.bytecode.program import Program
from lfield.mission.bindings import DEFAULT_LEASE, DEFAULT_RESERVATION, MAX_MEMBERS, ReservationTimes
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from simulation_testing.fault_injection import ORDERS, Fault, FaultRates
from simulation_testing.scenarios import crew_programs, flown_programs, keeper_programs

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
        for (int n = 0; n < 3; n = n + 1) {
            fc.setVelocity(i2f(drawn), i2f(number), i2f(n));
            sleep(0.1);
        }
        fc.hold();
        write("end " + life + " " + i2s(number) + "\\n");
    }
}
coordinator Walker {
    init(string[] arg) {
        int drawn = random(1000000000);
        string life = arg[0] + "." + i2s(drawn);
        //recovered
        print("born " + life);
        Post[] posts = findPost();
        Arm[] arms = findArm();
        int all = posts.length() + arms.length();
        int at = 0;
        int number = 0;
        while (number != s2i(arg[1])) {
            if (random(32) >= s2i(arg[3])) at = random(all);
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
                if (random(32) >= s2i(arg[3]) && random(3) == 0) posts[random(posts.length())].look();
            } catch (Exception other) { }
            sleep(0.02 + 0.1 * random());
        }
        print("over " + life);
    }
}
"""
#: The statement that permits recovery by a majority.
RECOVERED = "heartbeatInterval(s2f(arg[4]));"
_PROGRAMS: dict[bytes, Program] = {}
#: The number of calls of a walker that never ends.
FOR_EVER = -1
#: The faults of any scenario.
USUAL = [
    kind for kind in FaultRates.__dataclass_fields__ if kind not in ("swap", "split", "disk_slow", *ORDERS)
]
#: Least and greatest seconds between two faults of a kind, and the probability of each kind in a scenario.
BETWEEN, LIKELY = (0.7, 6.0), 0.35
#: The share of scenarios of hosts with journals.
KEEP = 0.75
#: In so many of 32 cases a walker calls the same host again; the first number is for recoverable walkers, so
#: that they continue on an isolated host.
STAYS, STAYS_ON = 8, (26, 31, 31)
#: Scenarios of recoverable coordinators have no faults that invalidate leases, and more time, in seconds.
NOT_FENCED, LONGER = ("disk_new", "race"), 6.0
#: Faults that make a host suspect a live one; the probability of each then.
DOUBTS, LIKELY_DOUBT = ("cut", "mute", "island", "stop", "kill"), 0.6
#: Seconds between two of these faults, and of such a scenario, if they are frequent.
OFTEN, DOUBTED = (2.0, 8.0), 8.0
#: Approximate start of walkers and time between two of their calls, in seconds; the number of leases without
#: a heartbeat after which a recovery has started.
START_TIME, BETWEEN_CALLS, RECOVERS_WITHIN = 0.2, 0.08, 3.0
#: Seconds without a heartbeat until a coordinator is recovered; the length of a lease.
INTERVALS, LEASES = (1.0, 1.0, 1.0, 2.0, 4.0, 10.0), (1.0, 2.0, 2.0, 4.0)
#: Seconds until a silent holder loses its reservation, and until a waiting caller is denied.
RESERVATIONS, RESERVED_WAITS = (1.0, 2.0, 4.0), (0.0, 0.5, 3.0, 10.0)
#: The number of voting hosts in a team of more than nine.
DECIDERS = 5
#: Seconds of a commit: on a laptop, and on a small board with a memory card.
DISKS = (0.002, 0.002, 0.05)


@dataclass(frozen=True, slots=True)
class Scenario:
    """All parameters of a run. Times are in seconds; `lost_after` is None for walkers without an end.

    Walkers make `calls` calls, FOR_EVER for no end, each of which takes `stay`. Hosts have `journals` on
    disks with commits of `sync`, or none. The forecast is drawn for a team of `cast` hosts and `weather`
    seconds; `keep` has the numbers of the injected faults, None for all. `hosts` and `seconds` are smaller in
    a shrunk scenario. With an `interval` a majority of the hosts may recover walkers, under leases of
    `lease`; then the last hosts, `witnesses`, have no agents. A walker `stays` on its host in so many of 32
    cases. Its reservations last for `reservation` without contact, and others wait for them for
    `reserved_wait`. Code takes `slowness` times its usual processor time. Faults that are `aimed` are
    injected in addition to the drawn ones.
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
    interval: float = 0.0
    lease: float = DEFAULT_LEASE
    kind: str = "plain"
    witnesses: int = 0
    stays: int = STAYS
    reservation: float = DEFAULT_RESERVATION
    reserved_wait: float = 0.0
    slowness: float = 1.0
    aimed: tuple[Fault, ...] = ()
    keep: frozenset[int] | None = None

    @property
    def mission(self) -> Mission:
        """The mission of the scenario; scenarios with equal mission parameters share it."""
        words = [str(self.calls), str(self.stay), str(self.stays)]
        if self.interval:
            words.append(f"{self.interval:g}")
        posts = max(1, self.hosts - self.witnesses)
        team = self.hosts, posts, self.walkers, self.arms
        program = PROGRAMS.get(self.kind, PROGRAM)
        times = self.lease, self.reservation, self.reserved_wait
        deciders = DECIDERS if self.hosts > MAX_MEMBERS else 0
        return _mission(*team, "&".join(words), *times, program, deciders)

    @property
    def forecast(self) -> list[Fault]:
        """The faults that are injected."""
        return [fault for _, fault in self.numbered if {fault.one, fault.other} <= self._names(self.hosts)]

    @property
    def numbered(self) -> list[tuple[int, Fault]]:
        """The faults that are kept, with their numbers."""
        cast = sorted(self._names(self.cast))
        drawn = FaultRates(**self.means).forecast(cast, random.Random(self.seed), self.weather)
        faults = [*drawn, *self.aimed]
        return [(n, fault) for n, fault in enumerate(faults) if self.keep is None or n in self.keep]

    def _names(self, hosts: int) -> set[str]:
        return {f"h{n}" for n in range(hosts)}


def plain(seed: int) -> Scenario:
    """A scenario of coordinators that wait for their hosts, or are lost with them."""
    rng = random.Random(f"story {seed}")
    hosts = rng.choice((3, 3, 3, 4, 4, 5, 6, 7))
    ends = rng.random() < 0.25
    arms = rng.choice((0, 0, 0, 1, 1, 2))
    means = {
        kind: rng.uniform(*BETWEEN)
        for kind in USUAL
        if rng.random() < LIKELY and (arms or not kind.startswith("guard"))
    }
    seconds = rng.uniform(4.0, 10.0)
    return Scenario(
        seed,
        hosts,
        seconds,
        hosts,
        rng.randint(1, 3),
        arms,
        rng.choice((6, 12)) if ends else FOR_EVER,
        rng.choice((0.04, 1.0)),
        seconds,
        rng.choice((0.5, 1.5, 3.0, 5.0)),
        rng.uniform(2.0, 5.0) if ends else None,
        means,
        rng.random() < KEEP,
        rng.choice(DISKS),
    )


def forgetful(seed: int) -> Scenario:
    """A scenario of hosts without journals."""
    return replace(plain(seed), kind="forgetful", journals=False)


def fenced(seed: int) -> Scenario:
    """A scenario of coordinators that a majority may recover."""
    scenario, rng = replace(plain(seed), journals=True), random.Random(f"recovered {seed}")
    means = {kind: mean for kind, mean in scenario.means.items() if kind not in NOT_FENCED}
    means |= {kind: rng.uniform(*BETWEEN) for kind in DOUBTS if rng.random() < LIKELY_DOUBT}
    lease = rng.choice(LEASES)
    seconds = scenario.weather + LONGER + lease
    scenario = replace(
        scenario,
        kind="fenced",
        weather=seconds,
        seconds=seconds,
        lost_after=None,
        stay=rng.choice((0.04, 0.04, 0.04, 1.0)),
        interval=rng.choice(INTERVALS),
        stays=rng.choice(STAYS_ON),
        lease=lease,
        witnesses=rng.choice((0, 1)),
    )
    swaps = {"swap": rng.uniform(*OFTEN)} if rng.random() < LIKELY else {}
    return replace(scenario, means=means | swaps)


def doubted(seed: int) -> Scenario:
    """A scenario of a small team in which hosts often suspect live ones, whose coordinators continue."""
    scenario, rng = fenced(seed), random.Random(f"doubted {seed}")
    seconds = DOUBTED + 2.0 * scenario.lease
    return replace(
        scenario,
        kind="doubted",
        cast=3,
        hosts=3,
        arms=min(scenario.arms, 1),
        witnesses=0,
        calls=FOR_EVER,
        stay=0.04,
        interval=1.0,
        stays=STAYS_ON[-1],
        means={kind: rng.uniform(*OFTEN) for kind in DOUBTS},
        weather=seconds,
        seconds=seconds,
    )


def parted(seed: int) -> Scenario:
    """A scenario of a small team in which the former holder of a coordinator does not meet its successor.

    Only a host that has promised has information about both, on its disk: it is restarted in between.
    """
    mean = random.Random(f"parted {seed}").uniform(*OFTEN)
    return replace(doubted(seed), kind="parted", means={"swap": mean})


def ending(seed: int) -> Scenario:
    """A scenario of coordinators that terminate soon, which only some hosts are informed of.

    A link is cut shortly before the likely termination of the first coordinator, for the time of a recovery;
    sometimes all other links of that host are cut for the time of a promise.
    """
    scenario, rng = doubted(seed), random.Random(f"ending {seed}")
    hosts = rng.choice((3, 3, 4, 5))
    more = (*DOUBTS[1:], "power", "disk_slow")
    kinds = ["cut", *(kind for kind in more if rng.random() < LIKELY)]
    calls, stay = rng.randint(1, 8), rng.choice((0.04, 1.0))
    one, other = rng.sample([f"h{n}" for n in range(hosts)], 2)
    at = max(0.1, START_TIME + calls * (stay + BETWEEN_CALLS) - rng.uniform(0.0, 1.0))
    lasts = RECOVERS_WITHIN * scenario.lease + rng.uniform(1.0, 6.0)
    aimed = [Fault(at, "cut", one, other, lasts, 1.0)]
    if rng.random() < LIKELY:
        brief = scenario.interval + scenario.lease * rng.uniform(1.0, 2.5)
        others = (f"h{n}" for n in range(hosts))
        aimed += [Fault(at, "cut", one, far, brief, 1.0) for far in others if far not in (one, other)]
    return replace(
        scenario,
        kind="ending",
        cast=hosts,
        hosts=hosts,
        witnesses=rng.choice((0, 1)),
        calls=calls,
        stay=stay,
        stays=STAYS,
        means={kind: rng.uniform(0.5, 5.0) for kind in kinds},
        aimed=tuple(aimed),
        weather=max(scenario.weather, at + lasts),
        seconds=max(scenario.seconds, at + lasts),
    )


def crew(seed: int) -> Scenario:
    """A scenario of coordinators with concurrent calls; a majority may recover some of them."""
    rng = random.Random(f"crew {seed}")
    scenario = rng.choice((plain, fenced, doubted))(seed)
    means = {kind: mean for kind, mean in scenario.means.items() if not kind.startswith("guard")}
    return replace(
        scenario,
        kind="crew",
        means=means,
        walkers=min(scenario.walkers, 2),
        arms=0,
        calls=FOR_EVER,
        lost_after=None,
        journals=True,
    )


def racer(seed: int) -> Scenario:
    """A scenario of crews whose coordinators start calls and fetch them later, or only the first result."""
    return replace(crew(seed), kind="racer")


def keeper(seed: int) -> Scenario:
    """A scenario of coordinators that reserve resources; a majority may recover some of them.

    No clock in it is worse than leases allow for.
    """
    rng, scenario = random.Random(f"keeper {seed}"), crew(seed)
    means = {kind: mean for kind, mean in scenario.means.items() if kind != "race"}
    return replace(
        scenario,
        kind="keeper",
        means=means,
        walkers=rng.choice((2, 3)),
        reservation=rng.choice(RESERVATIONS),
        reserved_wait=rng.choice(RESERVED_WAITS),
    )


#: The programs for scenarios with devices.
PROGRAMS = {
    "crew": crew_programs.PROGRAM,
    "racer": crew_programs.RACER_PROGRAM,
    "keeper": keeper_programs.PROGRAM,
    "flown": flown_programs.PROGRAM,
}
#: Scenarios in which every round may have to wait for other reservations.
RESERVES = ("keeper", "flown")


@lru_cache(maxsize=16)
def _mission(
    hosts: int,
    posts: int,
    walkers: int,
    arms: int,
    arguments: str,
    lease: float,
    reservation: float,
    reserved_wait: float,
    program: str,
    deciders: int,
) -> Mission:
    lines = [f"//Post:p{n}@h{n}" for n in range(posts)]
    lines += [f"//@h{n}" for n in range(posts, hosts)]
    lines += [f"//Arm:a{n}@h{posts - 1 - n}" for n in range(min(arms, posts))]
    lines += [f"//Walker:w{n}@h{n % posts}?{arguments}" for n in range(walkers)]
    program = program.replace("//recovered", RECOVERED) if arguments.count("&") > 2 else program
    with tempfile.TemporaryDirectory(prefix="lfield-story-") as folder:
        deployment = Path(folder) / "story.dL"
        deployment.with_suffix(".L").write_text(program, encoding="utf-8")
        deployment.write_text("\n".join([*lines, ""]), encoding="utf-8")
        if deciders:
            members = ", ".join(f"h{n}" for n in range(deciders))
            devices = f"recovery: {{members: [{members}]}}\n"
            deployment.with_suffix(".devices.yaml").write_text(devices, encoding="utf-8")
        mission = load_mission(deployment, simulate=True)
    # Prepared data of a program on a host is large: one program is enough.
    times = ReservationTimes(reservation, reserved_wait)
    recovery = structs.replace(mission.bindings.recovery, lease=lease)
    bindings = structs.replace(mission.bindings, recovery=recovery, reservations=times)
    return replace(
        mission, bindings=bindings, program=_PROGRAMS.setdefault(mission.program.digest, mission.program)
    )
