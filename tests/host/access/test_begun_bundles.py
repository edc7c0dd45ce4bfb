"""What a host keeps of the signed bundle that it runs: a restart in flight asks nobody to sign again."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from lfield.authority.admission import Judged
from lfield.authority.believed import BelievedTime
from lfield.authority.identity import Right
from lfield.authority.judge import Revoked
from lfield.authority.reading import identity_in
from lfield.authority.signature import sign
from lfield.clock import SystemClock
from lfield.errors import SignatureError
from lfield.host.process.proving import Proof, insist_on_signature
from lfield.host.team.keeping import Recovery
from lfield.journal.pages import BundlePage, CopyPage
from lfield.mission.access.release import Release
from lfield.testing.keys import Keyring
from lfield.wire.coordinators import Known

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


def kept(team, host):
    return [page.digest for page in team.disks[host].pages() if isinstance(page, BundlePage)]


def signed(mission, by="anna"):
    return replace(mission, release=Release(DIGEST, b"", by, time.time()))


@pytest.mark.parametrize(("deployment", "left"), [(DONE, [b""]), (ENDLESS, [DIGEST])])
def test_a_signed_bundle_is_kept_until_its_mission_has_ended_in_order(fleet, deployment, left):
    async def story(team):
        mission = signed(team.mission(PROGRAM, deployment))
        alpha, bravo = await team.up(mission, keeps=True)
        if deployment == DONE:
            await team.ended("tom")
        await team.until(lambda: kept(team, "alpha") == kept(team, "bravo") == [DIGEST])
        await alpha.host.stop()
        assert kept(team, "alpha") == left
        # A host without coordinators of its own has begun it as well, and has to go on with it as long.
        assert kept(team, "bravo") == [DIGEST]
        await bravo.host.stop()
        assert kept(team, "bravo") == left

    fleet(story)


def test_a_host_that_holds_a_coordinator_of_another_home_goes_on_with_its_bundle(fleet):
    async def story(team):
        mission = signed(team.mission(GUEST, "//Caller:tom@alpha?go\n//Echo:echo@bravo\n"))
        alpha, bravo = await team.up(mission, keeps=True)
        await team.until(lambda: bravo.holds("tom"))
        await bravo.host.stop()
        await alpha.host.stop()
        assert [kept(team, host) for host in ("alpha", "bravo")] == [[DIGEST], [DIGEST]]

    fleet(story)


def test_an_ending_of_an_earlier_run_does_not_end_the_bundle_of_this_one(fleet):
    async def story(team):
        once = signed(team.mission(GUEST, "//Caller:tom@alpha\n//Echo:echo@bravo\n"))
        alpha, bravo = await team.up(once, keeps=True)
        await team.ended("tom")
        await team.until(lambda: any(row.state == "EXITED" for row in bravo.host.mobility.knowledge()))
        await bravo.host.stop()
        await alpha.host.stop()
        assert [kept(team, host) for host in ("alpha", "bravo")] == [[b""], [b""]]
        # The devices of another computer are not up yet, so nothing is heard of what goes on there.
        (bravo,) = await team.up(once, "bravo", keeps=True)
        await team.until(lambda: kept(team, "bravo") == [DIGEST])
        await bravo.host.stop()
        assert kept(team, "bravo") == [DIGEST]

    fleet(story)


def test_what_ended_before_a_restart_in_flight_has_ended_after_it():
    pages = [CopyPage("tom", 1, "EXITED", 1, 1, outcome="done")]
    tom, ann = Known("tom", 1, 1, 1, "EXITED"), Known("ann", 1, 1, 1, "EXITED")
    again = Recovery([*pages, BundlePage(DIGEST)], b"", DIGEST)
    assert again.over(("tom",), [tom])
    assert again.over(("tom", "ann"), [tom, ann])
    # Nothing is heard of ann; tom runs again.
    assert not again.over(("tom", "ann"), [tom])
    assert not again.over(("tom",), [tom, Known("tom", 2, 1, 1, "RUN")])
    for other in (b"", b"c" * 32):
        assert not Recovery([*pages, BundlePage(other)], b"", DIGEST).over(("tom",), [tom])


def test_of_a_bundle_that_nobody_had_to_sign_nothing_is_kept(fleet):
    async def story(team):
        mission = signed(team.mission(PROGRAM, DONE), by="")
        await team.up(mission, keeps=True)
        await team.ended("tom")
        assert kept(team, "alpha") == []

    fleet(story)


def test_after_a_restart_in_flight_a_signature_counts_that_no_start_would_take(fleet, tmp_path):
    ring = Keyring(tmp_path / "keys")
    anna, host = ring.made("person", "anna", Right.COMMAND), ring.made("host", "alpha")

    async def story(team):
        release = Release(DIGEST, sign(DIGEST, anna, time.time()))
        mission = replace(team.mission(PROGRAM, ENDLESS), release=release)
        own = identity_in(host.certificate, host.authority)
        who = identity_in(anna.certificate, anna.authority)
        revoked = Revoked(4, frozenset({who.serial}), time.time())
        good, bad = (Judged(host, own, BelievedTime(SystemClock()), found) for found in (Revoked(), revoked))
        proof = Proof(host)
        first = insist_on_signature(mission, proof, good, ())
        assert (first.release.by, first.doubt) == ("anna", "")
        with pytest.raises(SignatureError, match=r"are revoked \(list 4\)"):
            insist_on_signature(mission, proof, bad, [BundlePage(b"")])
        with pytest.raises(SignatureError, match=r"are revoked \(list 4\)"):
            insist_on_signature(mission, proof, bad, [BundlePage(b"c" * 32)])
        again = insist_on_signature(mission, proof, bad, [BundlePage(DIGEST)])
        assert again.release == first.release
        assert "are revoked (list 4)" in again.doubt
        # Whoever made the keys for this run alone has said what runs.
        vouched = Release(DIGEST, by="whoever started it", at=1.0)
        assert insist_on_signature(mission, replace(proof, vouched=vouched), bad, ()).release == vouched
        other = replace(mission, release=Release(b"c" * 32))
        with pytest.raises(SignatureError, match="nobody has signed it"):
            insist_on_signature(other, replace(proof, vouched=vouched), good, ())

    fleet(story)
