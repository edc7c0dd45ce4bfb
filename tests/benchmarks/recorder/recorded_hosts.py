"""The cost of a recording for real hosts: processor time including their guards, and bytes of files."""

from __future__ import annotations

import importlib.util
import os
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from harness.checkout import Checkout
from harness.processes import Child, Processes
from machine.small import processor_seconds

#: Seconds of settling after the start, and seconds of measurement of each team.
SETTLED, SECONDS = 1.0, 10.0
_HERE = Path(__file__).parent
EXAMPLES = _HERE.parents[2] / "examples"
_PARKED = "resource Part { init(string[] arg) { while (true) yield(); } }\n"
_HOPS = re.compile(r"(\d+) hops$")
#: Parts of the command lines of the processes of a host.
_OURS = (b"--host=", b"lfield.guard.process")


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one host: percent of a processor and bytes a minute; and the hops of its team a second."""

    processor: float
    bytes_a_minute: float
    hops: float


@dataclass(frozen=True, slots=True)
class Team:
    """A deployment and options of `lfield up`; `places` are folders of uninstalled drivers."""

    deployment: Path
    options: Sequence[str] = ()
    places: Sequence[str] = ()


def teams(processes: Processes) -> Mapping[str, Team]:
    """The measured teams by case."""
    rest, walk, site = processes.folder(), processes.folder(), processes.folder()
    (rest / "mission.L").write_text(_PARKED, encoding="utf-8")
    (rest / "mission.dL").write_text("//Part:one@here\n//Part:two@there\n", encoding="utf-8")
    (walk / "mission.L").write_text((_HERE / "walk.L").read_text(encoding="utf-8"), encoding="utf-8")
    agents = "//Post:near@a\n//Post:far@b\n//Walker:walker@a?0.001&100\n"
    (walk / "mission.dL").write_text(agents, encoding="utf-8")
    places = _drivers_of_examples(site)
    return {
        "at rest": Team(rest / "mission.dL"),
        "example 01": Team(EXAMPLES / "01-first-flight/mission.dL", ("--sim",)),
        "example 20": Team(EXAMPLES / "20-gps-driver/mission.dL", ("--sim",), places),
        "1,000 hops a second": Team(walk / "mission.dL"),
    }


def _drivers_of_examples(site: Path) -> Sequence[str]:
    spec = importlib.util.spec_from_file_location("examples_conftest", EXAMPLES / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: list[str] = module.project_folders(site)
    return found


def cost_of(checkout: Checkout, team: Team, records: Path | None) -> Cost:
    """Measure a team with or without recording into a folder."""
    with Processes() as processes:
        where = ("--no-record",) if records is None else ("--record", str(records))
        arguments = (
            "--deploy",
            str(team.deployment),
            "--all",
            *checkout.keeping_nothing,
            *team.options,
            *where,
        )
        places = {"PYTHONPATH": os.pathsep.join(team.places)} if team.places else {}
        child = processes.start(
            checkout.python, "-m", "lfield", "up", *arguments,
            environment={**checkout.environment, **places}, folder=checkout.root, merged=True,
        )  # fmt: skip
        processes.at_end(lambda: (child.ask_to_end(), child.ended(30.0)))
        hosts = len({line.rpartition("@")[2].partition("?")[0] for line in _agents(team.deployment)})
        up = 0
        while up < hosts:
            up += " listening on " in child.line()
        time.sleep(SETTLED)
        return _measured(child, hosts, records)


def _agents(deployment: Path) -> list[str]:
    lines = deployment.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("//")]


def _measured(child: Child, hosts: int, records: Path | None) -> Cost:
    folders = _processes(child.pid)
    first, before, stored = _last_hop(child.lines(), 0), _spent(folders), _stored(records)
    start = time.perf_counter()
    time.sleep(SECONDS)
    elapsed = time.perf_counter() - start
    spent, written = _spent(folders) - before, _stored(records) - stored
    hops = _last_hop(child.lines(), first) - first
    return Cost(100 * spent / elapsed / hosts, 60 * written / elapsed / hosts, hops / elapsed)


def _processes(parent: int) -> list[Path]:
    """The /proc folders of the hosts and guards below a process."""
    found: list[Path] = []
    for task in Path(f"/proc/{parent}/task").iterdir():
        for word in (task / "children").read_text(encoding="ascii").split():
            folder = Path(f"/proc/{word}")
            if any(name in (folder / "cmdline").read_bytes() for name in _OURS):
                found.append(folder)
            found += _processes(int(word))
    return found


def _spent(folders: Sequence[Path]) -> float:
    return sum(map(processor_seconds, folders))


def _stored(records: Path | None) -> int:
    return 0 if records is None else sum(p.stat().st_size for p in records.rglob("*") if p.is_file())


def _last_hop(lines: Sequence[str], known: int) -> int:
    return max((int(found[1]) for line in lines if (found := _HOPS.search(line))), default=known)
