"""Pickers learn alone, and learn from each other: `lfield test examples/17-learning`."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import learning
import pytest

HERE = Path(__file__).parent
README = (HERE / "README.md").read_text(encoding="utf-8")


def held_parts(team):
    """The number of parts that held, for each shift."""
    matches = (re.search(r"shift \d+: (\d+) of 80 parts held", line.text) for line in team.log)
    return [int(match[1]) for match in matches if match]


def test_success_rate_rises_during_the_mission(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"teacher": "done"}
    shifts = held_parts(team)
    assert len(shifts) == 30
    assert sum(shifts[:2]) < 0.5 * 160
    assert sum(shifts[4:10]) > 0.8 * 480
    # Six hops for each shift: the calls that order the work also carry the experience.
    assert len(team.hops) == 180


@pytest.mark.few(0)
def test_pickers_that_share_learn_faster_with_the_same_hops():
    (alone, alone_hops), (shared, shared_hops) = (learning.run(4, shares, 0) for shares in (False, True))
    assert sum(shared[:10]) > 1.3 * sum(alone[:10])
    assert shared_hops == alone_hops


@pytest.mark.few(0)
def test_same_seed_repeats_a_run_exactly():
    assert learning.run(2, True, 3) == learning.run(2, True, 3)


def test_own_experience_is_separate_from_that_of_others(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="shift 5")
    picks = Counter()
    for call in team.calls:
        picks[call.resource] += 1
        assert sum(call.result.tried) == 20 * picks[call.resource]
        assert sum(call.arguments[1].tried) == 60 * (picks[call.resource] - 1)
    assert picks == dict.fromkeys(("north", "east", "south", "west"), 5)


@pytest.mark.few(0)
def test_readme_has_the_table_and_picture_of_the_script():
    results = learning.measure()
    assert learning.table(results) in README
    drawing = (HERE / "learning.svg").read_text(encoding="utf-8")
    assert learning.draw(results) == drawing, "run learning.py --write"
