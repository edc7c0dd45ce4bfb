"""Every planted bug of the service is found: by a known seed, or by a bounded search that reports another."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from planted_push_bugs import PUSH_BUGS, PushBug

from simulation_testing.services.push_runner import first_breach, run_push_seed


@pytest.mark.few(3)
@pytest.mark.parametrize("bug", PUSH_BUGS, ids=lambda bug: bug.name)
def test_a_planted_push_bug_is_found(
    bug: PushBug, monkeypatch: pytest.MonkeyPatch, record_property: Callable[[str, str], None]
) -> None:
    bug.plant(monkeypatch)
    found = run_push_seed(bug.seed).breaches
    if not found:
        other = first_breach(range(bug.within))
        assert other is not None, f"no seed from 0 to {bug.within - 1}: {bug.broken}"
        found = other.breaches
        record_property("note", f"{bug.name}: seed {other.scenario.seed} finds it, not {bug.seed}")
    assert found[0].name in bug.breaches
