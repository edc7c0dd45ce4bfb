"""Stories drawn from seeds keep every promise; one in which one is broken is found and made smaller."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest
from rich.console import Console

from lfield.journal.pages import CopyPage, Starts
from lfield.mobility.copies import Copy
from lfield.mobility.departures import Departures
from lfield.mobility.effects import Effect
from lfield.simulate.fleet import Fleet
from lfield.simulate.judge import Judge
from lfield.simulate.saved import nowhere
from lfield.simulate.seeds import run, told
from lfield.simulate.stories.shrink import command, smallest
from lfield.simulate.stories.story import drawn
from lfield.simulate.stories.trial import tell
from lfield.simulate.weather import Weather


@pytest.mark.parametrize("first", range(0, 160, 40))
def test_stories_of_all_kinds_of_weather_keep_every_promise(first: int) -> None:
    struck: Counter[str] = Counter()
    calls = restarts = 0
    for seed in range(first, first + 40):
        verdict = told(seed)
        assert not verdict.breaches, f"{verdict.breaches[0]}: {command(verdict.story)}"
        struck.update(fault.kind for fault in verdict.story.forecast)
        calls += verdict.calls
        restarts += verdict.restarts
    assert calls > 300
    assert restarts > 10
    assert set(struck) >= Weather.__dataclass_fields__.keys() - {"guard_kill", "guard_stop"}


def test_a_judge_sees_what_it_judges() -> None:
    judge = Judge()
    story = replace(drawn(1), keep=frozenset(), walkers=3, arms=0, stay=0.04)
    judge.fleet = Fleet(story.mission, 1, born=judge.born)
    judge.fleet.run(8.0)
    judge.look()
    assert not judge.breaches
    assert judge.seen["starts"] == story.walkers
    assert min(judge.seen["injections"], judge.seen["calls"]) > 10
    judge.fleet.close()


def test_a_story_is_the_same_in_every_process() -> None:
    """Sets of strings have another order in each."""
    line = [sys.executable, "-m", "lfield.simulate", "--story", "11", "--quiet"]
    environment = {**os.environ, "PYTHONHASHSEED": "77"}
    other = subprocess.run(line, env=environment, capture_output=True, text=True, check=True).stdout
    assert other.split()[-1] == told(11).digest
    assert told(12).digest != told(11).digest


def test_a_breach_is_told_with_the_command_that_repeats_it_and_made_smaller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def overdue(self: Departures, copy: Copy) -> list[Effect]:
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    monkeypatch.setattr(Departures, "overdue", overdue)
    found = told(5)
    breach = found.breaches[0]
    assert (breach.name, len(breach.hosts)) == ("I1", 2)
    small = smallest(found, most=40)
    assert small.breaches[0].name == "I1"
    assert len(small.faults) < len(found.faults)
    assert tell(small.story).digest == small.digest
    assert command(small.story).startswith("python -m lfield.simulate --story 5 --")
    said = Console(file=io.StringIO(), width=200)
    tally = run(range(5, 6), processes=1, console=said)
    assert [verdict.digest for verdict in tally.broken] == [found.digest]
    assert "1 seeds, 1 breaches (I1 1)" in said.file.getvalue()


@pytest.mark.parametrize(
    ("page", "held"),
    [
        (CopyPage("w", 2, "RUN", block=b"x"), True),
        (CopyPage("w", 2, "RUN"), True),
        (CopyPage("w", 2, "PREPARED", block=b"x"), True),
        (CopyPage("w", 2, "PREPARED"), False),
        (CopyPage("w", 2, "MOVED", block=b"x"), False),
        (CopyPage("w", 2, "EXITED", outcome="done"), True),
        (CopyPage("w", 2, "EXITED", outcome="lost"), False),
        (CopyPage("w", 1, "RUN", block=b"x"), False),
    ],
)
def test_some_disk_must_hold_a_state_to_go_on_from(page: CopyPage, held: bool) -> None:
    assert nowhere([Starts(2), page], [("w", 2)]) == ([] if held else [("w", 2)])
