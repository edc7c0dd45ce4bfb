"""Hosts with keys run only bundles signed by a person with the right; `ps` shows the signer."""

from __future__ import annotations

import json
import re
import time

import pytest

from lfield.authority.identity import Right
from lfield.testing.keyring import Keyring

pytestmark = pytest.mark.process

PROGRAM = """
resource Echo { init(string[] arg) { } portal say() { write("here\\n"); } }
coordinator Caller { init(string[] arg) { findEcho("echo").say(); if (arg.length() > 1) sleep(1000.0); } }
"""
TEAM = "//Caller:tom@alpha{stays}\n//Echo:echo@bravo\n"


@pytest.fixture
def made(lfield, here):
    """`made()`: an unsigned bundle of a team of two, both of which have keys."""

    def make(stays: str = "") -> list[str]:
        lfield.mission(PROGRAM, TEAM.format(stays=stays))
        here("build", "mission.dL", status=0)
        return lfield.maps(["alpha", "bravo"])

    return make


def refused(lfield, *arguments: str) -> str:
    host = lfield("up", "mission.lfm", "--host", "alpha", *arguments, status=65)
    (line,) = host.err
    return line


@pytest.mark.few(0)
def test_a_signed_bundle_runs_and_ps_shows_its_signer(lfield, here, made) -> None:
    maps = made("?stays")
    signed = here("sign", "mission.lfm")
    assert (signed.status, "signed by operator" in signed.err[0]) == (0, True)
    arguments = ("up", "mission.lfm", *maps, "--first-start")
    hosts = [lfield.start(*arguments, "--host", name) for name in ("alpha", "bravo")]
    hosts[1].wait_for("^here$")
    output = here("ps", "mission.lfm", *maps)
    digest = re.search(r"bundle (\w{16})", signed.err[0])
    assert digest is not None
    assert output.status == 0, output
    pattern = rf"bundle {digest[1]}, signed by operator \d{{4}}-\d\d-\d\d \d\d:\d\d UTC: alpha, bravo"
    assert re.fullmatch(pattern, output.out[-1])
    data = json.loads("\n".join(here("ps", "mission.lfm", *maps, "--json").out))["bravo"]["bundle"]
    assert (data["digest"], data["signed_by"]) == (digest[1], "operator")
    assert abs(data["signed"] - time.time()) < 600.0


@pytest.mark.few(0)
def test_a_mission_from_files_is_signed_by_its_user(lfield, made) -> None:
    maps = made()
    arguments = ("up", "--deploy", "mission.dL", *maps, "--until-done", "--first-start")
    hosts = [lfield.start(*arguments, "--host", name) for name in ("alpha", "bravo")]
    assert [host.wait() for host in hosts] == [0, 0]
    assert hosts[1].out == ["here"]


def test_a_bundle_without_a_valid_signature_does_not_run(lfield, here, made, tmp_path) -> None:
    maps = made()
    assert "it is not signed: sign it with 'lfield sign'" in refused(lfield, *maps)
    # A person with only the operate right cannot sign, and their builds do not run either.
    keys = lfield.keys.issue("person", "olga", Right.OPERATE)
    lfield.keys.put("me", keys)
    here("sign", "mission.lfm", status=65)
    built = lfield("up", "--deploy", "mission.dL", "--host", "alpha", *maps, status=65)
    assert "it is not signed" in built.said
    # A signature of another team is refused too.
    foreign = Keyring(tmp_path / "foreign")
    foreign.sign(lfield.folder / "mission.lfm")
    assert "is not of this authority" in refused(lfield, *maps)


@pytest.mark.few(0)
def test_a_refused_bundle_neither_creates_nor_discards_a_folder(lfield, here, made) -> None:
    maps = made()
    state = lfield.folder / "kept"
    assert "it is not signed" in refused(lfield, *maps, "--state", state)
    assert not state.exists()
    here("sign", "mission.lfm", status=0)
    arguments = ("up", "mission.lfm", *maps, "--first-start", "--until-done", "--state", state, "--host")
    assert [host.wait() for host in [lfield.start(*arguments, name) for name in ("alpha", "bravo")]] == [0, 0]
    journal = next(path for path in state.rglob("*") if path.is_file() and "alpha" in str(path))
    before = journal.stat().st_ino
    here("build", "mission.dL", status=0)
    assert "it is not signed" in refused(lfield, *maps, "--state", state, "--fresh", "--yes")
    assert journal.stat().st_ino == before


@pytest.mark.few(0)
def test_a_robots_own_devices_file_needs_no_new_signature(lfield, here, made) -> None:
    maps = made()
    lfield.write("robot.yaml", "unreachable_after: 5\n")
    arguments = ("up", "mission.lfm", *maps, "--until-done", "--first-start", "--devices", "robot.yaml")
    lfield.keys.put("me", lfield.keys.issue("person", "olga", Right.OPERATE))
    unsigned = lfield(*arguments, "--host", "alpha", status=65)
    assert "it is not signed" in unsigned.said
    lfield.keys.put("me", lfield.keys.issue("person", "carl", Right.COMMAND))
    lfield.keys.sign(lfield.folder / "mission.lfm")
    lfield.keys.put("me", lfield.keys.issue("person", "olga", Right.OPERATE))
    # The other run has the devices of the bundle.
    hosts = [lfield.start(*arguments, "--host", "alpha"), lfield.start(*arguments[:-2], "--host", "bravo")]
    assert [host.wait() for host in hosts] == [0, 0]


@pytest.mark.few(0)
def test_signed_bundles_that_differ_in_bindings_do_not_link_and_both_are_stopped(lfield, here, made) -> None:
    maps = made("?stays")
    here("sign", "mission.lfm", status=0)
    alpha = lfield.start("up", "mission.lfm", *maps, "--first-start", "--host", "alpha")
    alpha.wait_for("listening on")
    lfield.write("mission.devices.yaml", "unreachable_after: 5\n")
    for words in (("build", "mission.dL", "-o", "other.lfm"), ("sign", "other.lfm")):
        here(*words, status=0)
    bravo = lfield.start("up", "other.lfm", *maps, "--host", "bravo")
    bravo.wait_for(r"runs bundle \w{16} and \w+ runs bundle \w{16}: copy one of the two to both")
    stopped = here("estop", "--no-wait", "mission.lfm", *maps)
    assert {line.partition(":")[0] for line in stopped.out} >= {"alpha", "bravo"}, stopped
    assert bravo.out == []


@pytest.mark.few(0)
def test_hosts_that_build_from_files_may_have_their_own_devices(lfield, made) -> None:
    maps = made()
    lfield.write("robot.yaml", "unreachable_after: 5\n")
    arguments = ("up", "--deploy", "mission.dL", *maps, "--until-done", "--first-start")
    hosts = [
        lfield.start(*arguments, "--host", "alpha"),
        lfield.start(*arguments, "--host", "bravo", "--devices", "robot.yaml"),
    ]
    assert [host.wait() for host in hosts] == [0, 0]
    assert hosts[1].out == ["here"]


@pytest.mark.few(0)
def test_a_bit_changed_after_signing_is_detected(lfield, here, made) -> None:
    maps = made()
    here("sign", "mission.lfm", status=0)
    path = lfield.folder / "mission.lfm"
    data = bytearray(path.read_bytes())
    for place in (60, len(data) // 2, len(data) - 1):
        changed = bytearray(data)
        changed[place] ^= 1
        path.write_bytes(changed)
        assert re.search("not a valid bundle|does not run here", refused(lfield, *maps))


def test_all_hosts_of_one_command_need_no_signature(lfield, here, made) -> None:
    made("?stays")
    team = lfield.start("up", "mission.lfm", "--all")
    team.wait_for(r"\| here$")
    last_lines = " ".join(line.strip() for line in here("ps", "mission.lfm").out[-2:])
    assert re.search("bundle .{16}, signed by the user who started it .*: alpha, bravo$", last_lines)
