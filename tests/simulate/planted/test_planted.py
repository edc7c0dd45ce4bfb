"""Every planted bug is found: by a known seed, or by a bounded search that reports another one."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from planted_bugs import BUGS, Bug
from planted_order_bugs import ORDER_BUGS
from planted_quorum_bugs import QUORUM_BUGS
from planted_reserve_bugs import RESERVE_BUGS
from planted_terminated_bugs import TERMINATED_BUGS
from planted_together_bugs import FUTURE_BUGS, TOGETHER_BUGS

from simulation_testing.seed_runner import first_broken, run_seed

EVERY = [*BUGS, *QUORUM_BUGS, *TOGETHER_BUGS, *FUTURE_BUGS, *RESERVE_BUGS, *ORDER_BUGS, *TERMINATED_BUGS]


@pytest.mark.few(8)
@pytest.mark.parametrize("bug", EVERY, ids=lambda bug: bug.name)
def test_a_planted_bug_is_found(
    bug: Bug, monkeypatch: pytest.MonkeyPatch, record_property: Callable[[str, str], None]
) -> None:
    bug.plant(monkeypatch)
    found = run_seed(bug.seed, bug.draws).breaches
    if not found:
        other = first_broken(range(bug.first, bug.first + bug.within), bug.draws)
        assert other is not None, f"no seed from {bug.first} to {bug.first + bug.within - 1}: {bug.broken}"
        found = other.breaches
        record_property("note", f"{bug.name}: seed {other.scenario.seed} finds it, not {bug.seed}")
    assert found[0].name in bug.breaches
