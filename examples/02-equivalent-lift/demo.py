"""Runs the mission four times on fakes: as it is, then with one more robot that has failed each time.

    python examples/02-equivalent-lift/demo.py

Each run is `lfield up --all --sim --until-done`; once the hook is down, the faults of the run are set with
`lfield sim fault`, as one could by hand from another terminal. A team that has not noticed them when the
parcel is there chooses a robot that cannot lift it any more: on a busy computer that takes a while. So the
demo asks the team (`lfield query`) until it has noticed, and where the parcel was there before it runs again
with a later one.

Ends with 0 when the right robot came each time.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from lfield import exits
from lfield.cli.main import main as lfield

HERE = Path(__file__).parent

#: What hosts and devices say of themselves; the rest is the foreman's.
OTHERS = re.compile(r"\| (\w+\.\w+: |\w+ is up|linked with|lost the link|waiting for the devices)")
#: What the foreman asks for, and what it says when it has an answer, and when it has done it.
QUESTION = "Lift where payload >= 0.2"
CHOSEN, LIFTED = (
    re.compile(r"foreman: (\S+) shall lift|nobody can lift the parcel"),
    "foreman: the parcel went up by",
)
#: The seconds that the parcel takes to come, in the deployment's words, and the longest that is tried.
COMES, LATEST = "foreman@yard?crane&8.0", 128.0
#: Seconds between two questions to the team.
AGAIN = 0.5


@dataclass(frozen=True)
class Failure:
    """What fails beside what has failed in the runs before, and who lifts the parcel then ('' for nobody)."""

    device: str
    fault: str
    words: str
    lifts: str


FAILURES = (
    Failure("", "", "everything works", "crane"),
    Failure("crane.axis", "silence=true", "the crane's drive has lost its power", "sky"),
    Failure("sky.fc", "battery=0.15", "the copter's battery is low as well", "hand+arm"),
    Failure("hand.motor", "dead=true", "and the hand's servo is dead", ""),
)


@dataclass
class Run:
    """A run of the mission with the last of some failures, the parcel coming after `seconds`."""

    folder: Path
    failures: tuple[Failure, ...]
    seconds: float
    #: When the foreman has chosen somebody, and who has lifted the parcel in the end; None for nobody yet.
    chosen_at: float | None = None
    lifted: str = ""
    _candidate: str = ""
    #: Where the foreman's words go, also while a command is asked for its own.
    out: TextIO = field(default_factory=lambda: sys.stdout)
    hook_is_down: threading.Event = field(default_factory=threading.Event)

    @property
    def mission(self) -> Path:
        """The deployment, beside copies of the mission's other files."""
        return self.folder / "mission.dL"

    def start(self) -> subprocess.Popen[str]:
        """All hosts, as one would start them."""
        for file in HERE.glob("mission.*"):
            shutil.copy(file, self.folder)
        deployment = self.mission.read_text(encoding="utf-8")
        self.mission.write_text(
            deployment.replace(COMES, f"foreman@yard?crane&{self.seconds}"), encoding="utf-8"
        )
        options = ("--deploy", str(self.mission), "--all", "--sim", "--until-done")
        command = [sys.executable, "-m", "lfield", "up", *options]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def listen(self, lines: Iterator[str]) -> None:
        """Show what the foreman says, and note what it has chosen."""
        for line in lines:
            if not OTHERS.search(line):
                print(line, end="", file=self.out, flush=True)
            if "the parcel is coming" in line:
                self.hook_is_down.set()
            if (chosen := CHOSEN.search(line)) is not None:
                self.chosen_at = self.chosen_at or time.monotonic()
                self._candidate = chosen[1] or ""
            if LIFTED in line:
                self.lifted = self._candidate
        self.hook_is_down.set()

    def fail(self) -> None:
        """Set the faults of the fakes."""
        for each in self.failures:
            if each.device:
                asked(["sim", "fault", each.device, each.fault])
                print(f"      | ({each.words})", file=self.out, flush=True)

    def is_noticed(self) -> bool:
        """Whether the team would choose the right one now, as the foreman's host knows it."""
        said = asked(["query", QUESTION, "--deploy", str(self.mission), "--at", "yard", "--json"])
        answer = json.loads(said) if said else {"answered": []}
        if "yard" not in answer["answered"]:
            return False
        (lift,) = answer["capabilities"]
        return next((offer["agent"] for offer in lift["offers"]), "") == self.failures[-1].lifts


def asked(words: list[str]) -> str:
    """What a command of lfield prints, run in this process; '' when it has not worked."""
    with io.StringIO() as said, contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        status = lfield(words)
        return said.getvalue() if status in (exits.DONE, exits.FAILED) else ""


def once(failures: tuple[Failure, ...], seconds: float) -> tuple[bool, Run, int]:
    """One run: whether the failures were noticed before the parcel was there, what came, and how it ended."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), failures, seconds)
        with run.start() as mission:
            assert mission.stderr is not None
            listener = threading.Thread(target=run.listen, args=[mission.stderr])
            listener.start()
            run.hook_is_down.wait()
            run.fail()
            noticed = False
            while run.chosen_at is None and mission.poll() is None and not noticed:
                noticed = run.is_noticed() and run.chosen_at is None
                time.sleep(AGAIN)
            listener.join()
            return noticed, run, mission.wait()


def right(failures: tuple[Failure, ...]) -> bool:
    """Runs until the team has noticed all failures in time; whether the right robot came then.

    A device that has failed cannot be seen in its safe state: such a run ends with 3, however well the
    mission went.
    """
    seconds = float(COMES.rpartition("&")[2])
    while True:
        noticed, run, status = once(failures, seconds)
        if noticed or seconds >= LATEST:
            break
        seconds *= 2.0
        print(f"      | (too soon for this computer: again, with a parcel after {seconds:g} s)", flush=True)
    came = run.lifted == failures[-1].lifts
    if not came:
        print(
            f"{run.lifted or 'nobody'} has lifted it, not {failures[-1].lifts or 'nobody'}", file=sys.stderr
        )
    ended = status == (exits.DONE if len(failures) == 1 else exits.UNSAFE)
    if not ended:
        print(f"the mission ended with {status}", file=sys.stderr)
    return came and ended


def main() -> int:
    """All four runs, until one does not go as it should."""
    for count, failure in enumerate(FAILURES, 1):
        print(f"\nRun {count}: {failure.words}", flush=True)
        if not right(FAILURES[:count]):
            return exits.FAILED
    return exits.DONE


if __name__ == "__main__":
    sys.exit(main())
