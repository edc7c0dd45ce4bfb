"""Every planted bug is found: by a known seed, or by a bounded search that names another one.

`make simulate` searches from the first seed on.
"""

from __future__ import annotations

import os

import pytest
from planted_bugs import BUGS, Bug
from planted_order_bugs import ORDER_BUGS
from planted_quorum_bugs import QUORUM_BUGS
from planted_reserve_bugs import RESERVE_BUGS
from planted_terminated_bugs import TERMINATED_BUGS
from planted_together_bugs import TOGETHER_BUGS

from lfield.simulate.seeds import first_broken, told

by_name = pytest.mark.parametrize(
    "bug",
    [*BUGS, *QUORUM_BUGS, *TOGETHER_BUGS, *RESERVE_BUGS, *ORDER_BUGS, *TERMINATED_BUGS],
    ids=lambda bug: bug.name,
)


@by_name
def test_a_planted_bug_is_found(
    bug: Bug, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bug.plant(monkeypatch)
    found = told(bug.seed, bug.draws).breaches
    if not found:
        other = first_broken(range(bug.first, bug.first + bug.within), bug.draws)
        assert other is not None, f"no seed from {bug.first} to {bug.first + bug.within - 1}: {bug.why}"
        found = other.breaches
        with capsys.disabled():
            print(f"\n{bug.name}: seed {bug.seed} does not find it any more; write down {other.story.seed}")
    assert found[0].name in bug.breaches


@pytest.mark.skipif("LFIELD_PLANTED" not in os.environ, reason="minutes of a processor: make simulate")
@by_name
def test_a_planted_bug_is_found_within_a_thousand_seeds(bug: Bug, monkeypatch: pytest.MonkeyPatch) -> None:
    bug.plant(monkeypatch)
    found = first_broken(range(bug.first, bug.first + 1000), bug.draws)
    assert found is not None, bug.why
    print(f"{bug.name}: {found.story.seed - bug.first + 1} seeds; {found.breaches[0]}")
    assert found.breaches[0].name in bug.breaches
