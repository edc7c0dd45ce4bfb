"""Commands of root on runs that other users claim."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from lfield.cli.main import main
from lfield.cli.operations.estop import watch_safe_states
from lfield.operator import runs
from lfield.operator.runs import Run, RunManifest
from lfield.operator.safe_state_progress import SafeStateProgress
from lfield.operator.targets import TargetTeam, open_team


def claimed(*hosts: str, mission="/m/tour.dL", rest_within=60.0) -> Run:
    """A run of mallory without a listener."""
    addresses = {host: f"{number}.sock" for number, host in enumerate(hosts)}
    note = RunManifest(mission, "d" * 64, 7, 1.0, rest_within, dict.fromkeys(hosts, "127.0.0.1:1"), addresses)
    return Run(Path("/nowhere/tour-0a1b2c3d"), note, "mallory", is_foreign=True)


@pytest.fixture
def there(monkeypatch):
    """Makes these runs visible to commands."""

    def found(*all: Run) -> None:
        monkeypatch.setattr(runs, "runs_here", lambda: list(all))

    return found


def test_text_of_a_foreign_manifest_is_escaped_for_the_terminal(there, capsys):
    there(claimed("a\x1b[31m", mission="/m/\x1b]0;mine\x07.dL"))
    for command in ("ps", "estop", "resume", "pause", "recover"):
        assert main([command, *(["walk"] if command == "recover" else [])]) in (3, 69)
        output = "".join(capsys.readouterr())
        assert "a\\u{1b}[31m" in output
        assert "\x1b" not in output
        assert "\x07" not in output


@pytest.mark.few(0)
def test_a_foreign_manifest_with_thousands_of_hosts_is_a_few_lines(there, capsys):
    there(claimed(*(f"h{number}" for number in range(4000))))
    for command, status in (("ps", 69), ("estop", 3)):
        assert main([command]) == status
        output = capsys.readouterr()
        assert len(output.out) < 6000
        (line,) = output.err.splitlines()
        assert line.startswith("4000 hosts of mallory/tour-0a1b2c3d: ")


def test_events_follow_a_limited_number_of_hosts_of_another_user(there, capsys):
    there(claimed(*(f"h{number}" for number in range(40))))
    assert main(["events", "--no-follow"]) == 69
    output = capsys.readouterr().err
    assert "lfield: 8 hosts of user mallory are left out: name a run with --run" in output
    assert "h31: unreachable" in output
    assert "h32" not in output


@pytest.mark.parametrize("words", [("query", "Lift"), ("watch",)])
def test_a_file_named_by_another_user_is_not_opened(there, capsys, tmp_path, words):
    fifo = tmp_path / "tour.dL"
    os.mkfifo(fifo)
    there(claimed("alpha", mission=str(fifo)))
    for more in ((), ("--run", "0a1b2c3d")):
        assert main([*words, *more]) == 64
        assert capsys.readouterr().err == (
            "lfield: only other users run missions here, name one with its file and --run: "
            f"mallory/tour-0a1b2c3d ({fifo})\n"
        )


def test_a_named_mission_is_asked_at_its_addresses_and_others_are_named(there, capsys, tmp_path):
    file = tmp_path / "tour.dL"
    file.write_text("//Post:near@localhost:1\n")
    (tmp_path / "tour.L").write_text("resource Post { portal hold() { } }\n")
    (tmp_path / "tour.capabilities.yaml").write_text("registry: 1\nproviders: {Post: {serves: {Hold: {}}}}\n")
    false = claimed("localhost")
    digest = open_team(file).deployment.hex()
    there(
        Run(
            false.folder,
            msgspec.structs.replace(false.manifest, deployment=digest),
            "mallory",
            is_foreign=True,
        )
    )
    main(["query", "Hold", str(file)])
    output = capsys.readouterr().err
    assert (
        "lfield: runs of other users are not included; select one with --run: mallory/tour-0a1b2c3d" in output
    )
    assert "/nowhere" not in output


def test_the_descent_limit_of_another_user_is_not_used(monkeypatch):
    granted = []

    class Given(SafeStateProgress):
        def __init__(self, within: float, now: float) -> None:
            super().__init__(within, now)
            granted.append(within)

    monkeypatch.setattr("lfield.operator.safe_state_progress.SafeStateProgress", Given)
    for rest_within in (90.0, 1e6):
        run = claimed("alpha", rest_within=rest_within)
        assert watch_safe_states(
            [TargetTeam((run,), {"alpha": run.control_socket("alpha")})], {}, {}, None
        ) == (0, {})
    assert granted == [90.0, 120.0]
