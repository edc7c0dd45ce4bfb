"""Orders of commands with unread output (Ctrl-S, a full pipe): output does not delay an order."""

from __future__ import annotations

import fcntl
import os
import sys
import threading
import tty
from contextlib import suppress

import pytest

from lfield.cli.main import main
from lfield.cli.operations import watch
from lfield.errors import AddressError
from lfield.operator import client
from lfield.wire.observer_messages import EmergencyStopResult

#: Many devices with long names: their lines are more than a pipe or a terminal holds.
DEVICES = {f"agent.{'d' * 900}{number}": "" for number in range(200)}


def pipe():
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    return reading, writing


def terminal():
    reading, writing = os.openpty()
    tty.setraw(writing)
    return reading, writing


unread = pytest.mark.parametrize("opened", [pipe, terminal])


def run_unread(monkeypatch, opened, words: list[str], event: threading.Event) -> tuple[bool, bytes, int]:
    """Run a command whose output is read only after the event, or after a minute without it.

    Returns whether the event occurred, the output, and the exit status.
    """
    reading, writing = opened()
    found, status = bytearray(), []
    with monkeypatch.context() as patch, os.fdopen(writing, "w") as stuck, os.fdopen(reading, "rb"):
        patch.setattr(sys, "stdout", stuck)
        patch.setattr(sys, "stderr", stuck)
        command = threading.Thread(target=lambda: status.append(main(words)), daemon=True)
        command.start()
        is_set = event.wait(60.0)
        os.set_blocking(reading, False)
        is_over = False
        while not is_over:
            # The output of a command is complete after its end.
            is_over = not command.is_alive()
            with suppress(BlockingIOError):
                while True:
                    found += os.read(reading, 1 << 16)
            command.join(0.01)
    return is_set, bytes(found), status[0]


@unread
@pytest.mark.parametrize("command", ["estop", "pause"])
def test_all_hosts_are_ordered_though_the_output_is_unread(here_mission, opened, monkeypatch, command):
    request_received = threading.Event()

    def ask_in_turn(teams, request, keys):
        first, *others = [place for team in teams for place in team.host_refs]
        yield {first: EmergencyStopResult(DEVICES)}
        yield {place: AddressError("nowhere", "no answer") for place in others}
        request_received.set()

    monkeypatch.setattr(client, "ask_in_turn", ask_in_turn)
    arguments = [command, "--deploy", str(here_mission), "--no-wait"]
    went_on, lines, status = run_unread(monkeypatch, opened, arguments, request_received)
    assert went_on, "the command waits for its reader before all hosts have the order"
    assert lines.count(b": safe") == len(DEVICES), "output without a reader is lost"
    assert lines.count(b"NOT REACHED") == 1
    assert status == 3


@unread
def test_the_page_is_served_though_the_output_is_unread(opened, monkeypatch):
    served = threading.Event()

    def run(args):
        print("x" * 200_000)
        served.set()
        return 130

    monkeypatch.setattr(watch, "_run", run)
    went_on, _, status = run_unread(monkeypatch, opened, ["watch"], served)
    assert went_on
    assert status == 130


@pytest.fixture
def here_mission(tmp_path):
    deployment = tmp_path / "mission.dL"
    (tmp_path / "mission.L").write_text("coordinator Nobody { init(string[] arg) { } }\n")
    deployment.write_text("//Nobody:one@alpha\n//Nobody:two@bravo\n")
    return deployment
