"""`lfield events` and `lfield logs` of a running team: one order, across restarts, until Ctrl-C."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import time
from itertools import pairwise

import pytest
from mcap.reader import make_reader

from lfield import exit_status

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal visit(int n) { print("visit " + i2s(n)); }
}
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (true) {
            posts[n % 2].visit(n);
            sleep(0.2);
            n = n + 1;
        }
    }
}
"""
DEPLOYMENT = "//Post:p@alpha\n//Post:q@beta\n//Walker:walker@alpha\n"


@pytest.fixture(scope="module")
def walk(shared_lfield):
    """A team in which a coordinator migrates back and forth."""
    team = shared_lfield.start("up", "--deploy", shared_lfield.mission(PROGRAM, DEPLOYMENT), "--all", "--sim")
    team.wait_for(r"p: visit 4")
    team.deployment = shared_lfield.folder / "mission.dL"
    return team


def of(kind: str, whole: list[dict]) -> list[dict]:
    return [event for event in whole if event["kind"] == kind]


def test_all_events_come_in_one_order_with_their_causes(walk, here):
    output = here("events", "--deploy", walk.deployment, "--json", "--no-follow", status=exit_status.DONE)
    events = [json.loads(line) for line in output.out]
    assert {event["host"] for event in events} == {"alpha", "beta"}
    assert all(before["time"] <= after["time"] + 1e-9 for before, after in pairwise(of("came", events)))
    places = {(e["host"], e["incarnation"], e["number"]): n for n, e in enumerate(events)}
    arrivals = of("came", events)
    assert len(arrivals) >= 4
    for event in arrivals:
        cause = event["caused_by"]
        place = places[cause["host"], cause["incarnation"], cause["number"]]
        assert events[place]["kind"] == "left"
        assert place < places[event["host"], event["incarnation"], event["number"]]
    # All hosts use the clock of one computer, so the reported clocks must be equal.
    assert all((event["within"] or 0.0) < 0.5 for event in events)
    assert all(abs(event["time"] - event["at"]) <= (event["within"] or 0.0) + 0.01 for event in events)


def test_new_events_are_printed_until_ctrl_c(walk, lfield):
    watcher = lfield.start("events", "--deploy", walk.deployment, "--kinds", "left,came", "--host", "alpha")
    watcher.wait_for("came  agent=walker")
    watcher.signal(signal.SIGINT)
    assert watcher.wait() == exit_status.INTERRUPTED
    assert watcher.err == []
    assert all("  alpha  " in line for line in watcher.out)


def test_telemetry_and_hops_make_a_table(walk, lfield):
    watcher = lfield.start("events", "--deploy", walk.deployment, "--csv", "--rate", "10")
    watcher.wait_for("came,walker")
    watcher.wait_for("batteryVoltage")
    watcher.signal(signal.SIGINT)
    watcher.wait()
    rows = list(csv.DictReader(watcher.out))
    voltages = [float(row["value"]) for row in rows if row["quantity"] == "batteryVoltage"]
    assert all(10.0 < voltage < 20.0 for voltage in voltages)
    hops = [row for row in rows if row["kind"] == "came"]
    assert {(row["of"], row["from"], row["to"]) for row in hops} <= {
        ("walker", "alpha", "beta"),
        ("walker", "beta", "alpha"),
    }
    assert all(None not in row and None not in row.values() for row in rows)


def test_logs_have_the_lines_of_all_hosts_and_end(walk, here):
    output = here("logs", "--deploy", walk.deployment, status=exit_status.DONE)
    lines = [line.partition(" | ")[2] for line in output.out]
    visit_lines = [line for line in lines if "visit" in line]
    assert visit_lines[:4] == ["p: visit 0", "q: visit 1", "p: visit 2", "q: visit 3"]
    assert any("listening on" in line for line in lines)


def test_a_closed_reader_ends_the_command_quietly(walk, lfield):
    reading, writing = os.pipe()
    watcher = lfield.start("logs", "-f", "--deploy", walk.deployment, stdout=writing)
    os.close(writing)
    assert os.read(reading, 10)
    os.close(reading)
    assert watcher.wait() == exit_status.INPUT_OUTPUT
    assert watcher.err == []


def nth(watcher, text: str, count: int) -> None:
    """Wait until a text was printed `n` times."""
    end = time.monotonic() + 60.0
    while len([line for line in watcher.out if text in line]) < count:
        assert time.monotonic() < end, watcher.said
        time.sleep(0.02)


@pytest.mark.few(0)
def test_a_host_killed_and_started_again_is_reported_and_followed(lfield):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "beta"])
    arguments = ("up", "--deploy", deployment, *maps, "--sim")
    alpha = lfield.start(*arguments, "--host", "alpha")
    beta = lfield.start(*arguments, "--host", "beta")
    watcher = lfield.start("logs", "-f", "--deploy", deployment, *maps)
    watcher.wait_for(r"alpha \| p: visit")
    watcher.wait_for(r"beta \| q: visit")
    beta.signal(signal.SIGKILL)
    watcher.wait_for("beta: unreachable: ")
    again = lfield.start(*arguments, "--host", "beta")
    watcher.wait_for("beta: reachable again")
    watcher.wait_for("beta: restarted")
    again.wait_for("listening on")
    nth(watcher, " beta | beta listening on", 2)
    watcher.signal(signal.SIGINT)
    assert watcher.wait() == exit_status.INTERRUPTED
    assert alpha.popen.poll() is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--kinds", "cane"], "unknown kind of events 'cane'; the kinds are"),
        (
            ["--csv", "--kinds", "latched"],
            "unknown kind of events 'latched'; the kinds are measured, path, left",
        ),
        (["--host", "gamma"], "no host 'gamma'; the hosts are alpha and beta"),
        (["--since", "-1"], "--since"),
        (["--rate", "50"], "the rate must be from 0 to 20 Hz"),
        (["--rate", "nan"], "the rate must be from 0 to 20 Hz"),
        (["--json", "--csv"], "not allowed with argument"),
    ],
)
def test_invalid_options_of_events_are_reported(words, message, walk, here):
    result = here("events", "--deploy", walk.deployment, *words, status=exit_status.USAGE)
    assert message in "\n".join(result.err)


def test_unreachable_hosts_have_a_status(lfield, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    result = here(
        "logs", "--deploy", deployment, *lfield.maps(["alpha", "beta"]), status=exit_status.UNAVAILABLE
    )
    assert result.out == []
    assert [line.split(":")[0] for line in result.err] == ["alpha", "beta"]


# --- recordings ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorders(walk, shared_lfield):
    """Start two recorders, each with its file."""
    found = {}
    for name in ("ended", "killed"):
        file = shared_lfield.folder / f"{name}.mcap"
        arguments = ("--json", "--mcap", file, "--rate", "10")
        found[name] = shared_lfield.start("events", "--deploy", walk.deployment, *arguments), file
    for recorder, _ in found.values():
        recorder.wait_for('"kind":"hopped"')
        recorder.wait_for('"kind":"measured"')
    return found


def topics(reader) -> set[str]:
    """The topics of a file; asserts that the messages are ordered by log time."""
    found = [
        (channel.topic, message.log_time)
        for _, channel, message in reader.iter_messages(log_time_order=False)
    ]
    times = [time for _, time in found]
    assert times == sorted(times)
    return {topic for topic, _ in found}


EXPECTED = {"/devices/p/fc", "/devices/p/fc/fix", "/events", "/hops", "/tf"}


@pytest.mark.few(0)
def test_a_terminated_recorder_completes_its_file(recorders):
    recorder, file = recorders["ended"]
    recorder.signal(signal.SIGTERM)
    assert recorder.wait() == exit_status.INTERRUPTED
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert topics(reader) >= EXPECTED
        summary = reader.get_summary()
    assert f"{file}: {summary.statistics.message_count} messages in " in recorder.err[-1]


def test_a_killed_recorder_leaves_a_valid_file(recorders):
    recorder, file = recorders["killed"]
    before = file.stat().st_size
    # A flush contains the output until one second before it.
    for _ in range(3):
        end = time.monotonic() + 60.0
        while file.stat().st_size == before:
            assert time.monotonic() < end
            time.sleep(0.02)
        before = file.stat().st_size
    recorder.signal(signal.SIGKILL)
    recorder.wait()
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert topics(reader) >= EXPECTED
        assert reader.get_summary() is None


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["--until-done", "--no-follow"], exit_status.USAGE),
        (["--until-done", "--lost-after", "0"], exit_status.USAGE),
        (["--mcap", "/dev/full", "--no-follow"], exit_status.NO_OUTPUT),
        (["--mcap", "/", "--no-follow"], exit_status.NO_OUTPUT),
        (["--mcap", __file__, "--no-follow"], exit_status.NO_OUTPUT),
    ],
)
def test_a_recording_that_cannot_be_made_is_one_sentence(words, status, walk, here):
    result = here("events", "--deploy", walk.deployment, *words, status=status)
    assert len([line for line in result.err if line.startswith("lfield: ")]) == 1
    assert result.out == []


FLOOD = """
resource Post { init(string[] arg) { } portal visit(int n) { } }
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (n < 400) { posts[n % 2].visit(n); n = n + 1; }
        n = 0;
        while (n < 30000) { print("line " + i2s(n)); n = n + 1; }
        sleep(600.0);
    }
}
"""
#: Separate teams: the team of `walk` runs at the same time.
FLOODED, LATER = (DEPLOYMENT.replace("q@", f"{name}@") for name in ("flooded", "later"))
SKIPPED = re.compile(r"(\d+) (?:lines|events of kind '(\w+)') left out: too frequent$")


def skipped(lines: list[str], kind: str | None = None) -> int:
    """The number of skipped lines in all messages about them."""
    found = [match for line in lines if (match := SKIPPED.search(line))]
    return sum(int(match[1]) for match in found if match[2] == kind)


@pytest.mark.few(0)
def test_lines_dropped_for_their_rate_are_counted_for_every_reader(lfield):
    deployment = lfield.mission(FLOOD, FLOODED)
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim")
    team.wait_for("walker: line 29999")
    logs = lfield("logs", "--deploy", deployment, status=exit_status.DONE)
    lines = [line for line in logs.out if " walker: line " in line]
    assert len(lines) > 8000
    assert skipped(logs.out) == 30000 - len(lines) > 0
    table = lfield("events", "--deploy", deployment, "--csv", "--no-follow", status=exit_status.DONE)
    left = len([row for row in csv.DictReader(table.out) if row["kind"] == "left"])
    assert skipped(table.err, "left") == 399 - left > 0
    output = lfield("events", "--deploy", deployment, "--no-follow", status=exit_status.DONE)
    assert any("skipped  skipped=left  count=" in line for line in output.out)


@pytest.mark.few(0)
def test_logs_started_before_the_mission_follow_each_of_its_runs(lfield):
    deployment = lfield.mission(PROGRAM, LATER)
    watcher = lfield.start("logs", "-f", "--deploy", deployment)
    watcher.wait_for(r"alpha: unreachable: .*the mission may not run there \(yet\)")
    for run in (1, 2):
        team = lfield.start("up", "--deploy", deployment, "--all", "--sim")
        nth(watcher, " alpha | p: visit 0", run)
        team.signal(signal.SIGINT)
        team.wait()
    watcher.signal(signal.SIGINT)
    assert watcher.wait() == exit_status.INTERRUPTED
