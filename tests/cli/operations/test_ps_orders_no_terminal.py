"""What a program or a host has said stands in the table as text: a terminal obeys nothing of it."""

import pytest
from scripted_snapshots import states_of

from lfield.cli.views import team_status_view
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import Status


def test_what_a_coordinator_died_of_is_text(capsys: pytest.CaptureFixture[str]) -> None:
    known = CoordinatorState("tom", 7, 1, 1, "EXITED", "alpha", "died", "E: \x1b[2J[/red]:smile:\aover")
    status = Status("alpha", "127.0.0.1:1", 2.5, b"p" * 32, b"d" * 32, [], [known], [], [], [])
    team_status_view.show(states_of({"alpha": status}))
    out = capsys.readouterr().out
    assert "died: E: \\u{1b}[2J[/red]:smile:\\u{7}over" in " ".join(out.split())
    assert not any(ord(ch) < 32 and ch != "\n" for ch in out)
