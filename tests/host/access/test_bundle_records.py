"""The record of the signed bundle that a host runs: a restart in flight needs no new signature."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from msgspec import structs

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.bundle_signature import sign_bundle
from lfield.authority.certificate_reader import identity_in
from lfield.authority.identity import Right
from lfield.authority.peer_verification import RevocationList
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import SystemClock
from lfield.errors import SignatureError
from lfield.host.migration.write_ahead import JournalContents
from lfield.host.process.credentials import HostCredentials, require_signature
from lfield.journal.records import BundleRecord, CoordinatorRecord
from lfield.mission.access.signed_bundle import BundleId
from lfield.testing.keyring import Keyring
from lfield.wire.coordinator_messages import CoordinatorState

PROGRAM = """
resource Echo { init(string[] arg) { } portal say() { sleep(1.0); } }
coordinator Caller { init(string[] arg) { if (arg.length() > 1) while (true) findEcho("echo").say(); } }
"""
GUEST = """
resource Echo { init(string[] arg) { } portal say() { while (true) sleep(1.0); } }
coordinator Caller { init(string[] arg) { if (arg.length() > 1) findEcho("echo").say(); } }
"""
ENDLESS, DONE = (f"//Caller:tom@alpha{words}\n//Echo:echo@alpha\n//Echo:far@bravo\n" for words in ("?on", ""))
DIGEST = b"b" * 32


def kept_digests(team, host):
    return [page.digest for page in team.disks[host].records() if isinstance(page, BundleRecord)]


def signed(mission, by="anna"):
    return replace(mission, release=BundleId(DIGEST, b"", by, time.time()))


@pytest.mark.parametrize(("deployment", "left"), [(DONE, [b""]), (ENDLESS, [DIGEST])])
async def test_a_signed_bundle_is_kept_until_its_mission_has_ended_regularly(team, /, deployment, left):
    mission = signed(team.mission(PROGRAM, deployment))
    alpha, bravo = await team.up(mission, keeps=True)
    if deployment == DONE:
        await team.ended("tom")
    await team.until(lambda: kept_digests(team, "alpha") == kept_digests(team, "bravo") == [DIGEST])
    await alpha.host.stop()
    assert kept_digests(team, "alpha") == left
    # A host without its own coordinators has started the bundle as well, and keeps it as long.
    assert kept_digests(team, "bravo") == [DIGEST]
    await bravo.host.stop()
    assert kept_digests(team, "bravo") == left


async def test_a_host_with_a_coordinator_of_another_home_keeps_its_bundle(team, /):
    mission = signed(team.mission(GUEST, "//Caller:tom@alpha?go\n//Echo:echo@bravo\n"))
    alpha, bravo = await team.up(mission, keeps=True)
    await team.until(lambda: bravo.holds("tom"))
    await bravo.host.stop()
    await alpha.host.stop()
    assert [kept_digests(team, host) for host in ("alpha", "bravo")] == [[DIGEST], [DIGEST]]


async def test_an_end_in_an_earlier_run_does_not_end_the_bundle_of_this_run(team, /):
    once = signed(team.mission(GUEST, "//Caller:tom@alpha\n//Echo:echo@bravo\n"))
    alpha, bravo = await team.up(once, keeps=True)
    await team.ended("tom")
    await team.until(lambda: any(row.state == "EXITED" for row in bravo.host.mobility.known_states()))
    await bravo.host.stop()
    await alpha.host.stop()
    assert [kept_digests(team, host) for host in ("alpha", "bravo")] == [[b""], [b""]]
    # The devices of another computer are not open yet, so no event of it arrives.
    (bravo,) = await team.up(once, "bravo", keeps=True)
    await team.until(lambda: kept_digests(team, "bravo") == [DIGEST])
    await bravo.host.stop()
    assert kept_digests(team, "bravo") == [DIGEST]


def test_ends_before_a_restart_in_flight_count_after_it():
    pages = [CoordinatorRecord("tom", 1, "EXITED", 1, 1, outcome="done")]
    tom, ann = CoordinatorState("tom", 1, 1, 1, "EXITED"), CoordinatorState("ann", 1, 1, 1, "EXITED")
    again = JournalContents([*pages, BundleRecord(DIGEST)], b"", DIGEST)
    assert again.is_mission_over(("tom",), [tom])
    assert again.is_mission_over(("tom", "ann"), [tom, ann])
    # No record of ann has been received; tom runs again.
    assert not again.is_mission_over(("tom", "ann"), [tom])
    assert not again.is_mission_over(("tom",), [tom, CoordinatorState("tom", 2, 1, 1, "RUN")])
    for other in (b"", b"c" * 32):
        assert not JournalContents([*pages, BundleRecord(other)], b"", DIGEST).is_mission_over(
            ("tom",), [tom]
        )


async def test_a_bundle_that_needs_no_signature_is_not_kept(team, /):
    mission = signed(team.mission(PROGRAM, DONE), by="")
    await team.up(mission, keeps=True)
    await team.ended("tom")
    assert kept_digests(team, "alpha") == []


async def test_after_a_restart_in_flight_a_revoked_signature_is_accepted_with_a_warning(team, /, tmp_path):
    ring = Keyring(tmp_path / "keys")
    anna, host = ring.issue("person", "anna", Right.COMMAND), ring.issue("host", "alpha")

    release = BundleId(DIGEST, sign_bundle(DIGEST, anna, time.time()))
    mission = replace(team.mission(PROGRAM, ENDLESS), release=release)
    own = identity_in(host.certificate, host.authority)
    identity = identity_in(anna.certificate, anna.authority)
    revoked = RevocationList(4, frozenset({identity.serial}), time.time())
    good, bad = (
        CertificateAdmission(host, own, TrustedClock(SystemClock()), found)
        for found in (RevocationList(), revoked)
    )
    proof = HostCredentials(host)
    first = require_signature(mission, proof, good, ())
    assert (first.bundle.by, first.warning) == ("anna", "")
    with pytest.raises(SignatureError, match=r"are revoked \(list 4\)"):
        require_signature(mission, proof, bad, [BundleRecord(b"")])
    with pytest.raises(SignatureError, match=r"are revoked \(list 4\)"):
        require_signature(mission, proof, bad, [BundleRecord(b"c" * 32)])
    again = require_signature(mission, proof, bad, [BundleRecord(DIGEST)])
    assert again.bundle == first.bundle
    assert "are revoked (list 4)" in again.warning
    # The person who made the keys for this run has stated which bundle runs.
    vouched = BundleId(DIGEST, by="the person who started it", at=1.0)
    assert (
        require_signature(mission, structs.replace(proof, accepted_bundle=vouched), bad, ()).bundle == vouched
    )
    other = replace(mission, release=BundleId(b"c" * 32))
    with pytest.raises(SignatureError, match="it is not signed"):
        require_signature(other, structs.replace(proof, accepted_bundle=vouched), good, ())
