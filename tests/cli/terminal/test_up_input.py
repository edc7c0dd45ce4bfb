"""`read` in real processes: lines on the standard input of a host, and of `--all` by the name of the host."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lfield.text import log_messages
from lfield.vm.waits.operator_input import MAX_LINE

pytestmark = pytest.mark.process

PROGRAM = """
resource Desk {
    init(string[] arg) { }
    portal ask(string question, real limit) emit string { write(question); return read(limit); }
}
resource Post { init(string[] arg) { } }
coordinator Asker {
    init(string[] arg) {
        for (int i = 2; i < arg.length(); i += 1) {
            try { print(arg[i] + " said " + findDesk(arg[i]).ask("ready?", s2f(arg[1]))); }
            catch (TimeLimitException e) { print(e.source() + " said nothing"); }
        }
    }
}
"""
ONE = "//Asker:asker@alpha?{limit}&d1\n//Desk:d1@alpha\n"
TWO = "//Asker:asker@alpha?{limit}&d1&d2\n//Desk:d1@alpha\n//Desk:d2@bravo\n//Post:post@carol\n"

LONG = "x" * MAX_LINE


def said(process) -> list[str]:
    lines = [line.rpartition("asker: ")[2] for line in process.err if "asker: " in line]
    return [line for line in lines if " said " in line]


@pytest.mark.few(0)
@pytest.mark.parametrize("options", [("--host", "alpha"), ("--all",)])
def test_a_single_reading_host_needs_no_name(lfield, options):
    deployment = lfield.mission(PROGRAM, ONE.format(limit=50))
    run = lfield.start("up", "--deploy", deployment, *options, "--until-done", stdin=True)
    run.popen.stdin.write(b"caf\xc3\xa9 \xff\n")
    run.popen.stdin.flush()
    assert run.wait() == 0
    assert said(run) == ["d1 said caf\u00e9 \ufffd"]
    assert any(line.endswith("ready?") for line in run.out)


@pytest.mark.few(0)
def test_lines_are_addressed_to_hosts(lfield):
    deployment = lfield.mission(PROGRAM, TWO.format(limit=50))
    run = lfield.start("up", "--deploy", deployment, "--all", "--until-done", stdin=True)
    run.popen.stdin.write(b"go\ncarol: go\nbravo: no: not yet\nalpha:" + LONG.encode() + b"\n")
    run.popen.stdin.close()
    assert run.wait() == 0
    assert sorted(said(run)) == [f"d1 said {LONG}", "d2 said no: not yet"]
    assert run.err.count(log_messages.INPUT_UNADDRESSED.line(hosts="alpha or bravo")) == 2
    assert not any("shortened" in line for line in run.err)


@pytest.mark.few(0)
@pytest.mark.parametrize("options", [("--host", "alpha"), ("--all",)])
def test_without_input_the_time_limit_ends_the_read(lfield, options):
    deployment = lfield.mission(PROGRAM, ONE.format(limit=0.5))
    run = lfield("up", "--deploy", deployment, *options, "--until-done", status=0)
    assert said(run) == ["d1 said nothing"]


@pytest.mark.few(0)
def test_a_host_with_closed_input_reads_nothing(lfield):
    deployment = lfield.mission(PROGRAM, ONE.format(limit=0.5))
    command = ["sh", "-c", 'exec "$@" <&-', "sh", sys.executable, "-m", "lfield"]
    arguments = ["up", "--deploy", str(deployment), "--host", "alpha", "--until-done"]
    ran = subprocess.run(
        [*command, *arguments], cwd=lfield.folder, env=lfield.environment, timeout=60,
        capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "asker: d1 said nothing" in ran.stderr
