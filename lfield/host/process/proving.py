"""With what a host proves who it is, and whom it believes: made ready before anything of it moves.

Without keys it listens at no address: commands of this computer find it at its door, and a team of several
hosts does not begin.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfield.authority.admission import Judged
from lfield.authority.believed import BelievedTime
from lfield.authority.identity import Identity
from lfield.authority.judge import Revoked, when
from lfield.authority.keys import Keys
from lfield.clock import Clock
from lfield.errors import KeysError, UsageError
from lfield.host.process.own_list import ListKeeper, newest_list
from lfield.journal.pages import BundlePage, Page
from lfield.mission.access.release import FROM_FILES, Release, Taken, taken
from lfield.mission.mission import Mission
from lfield.net.tls import Seen, Tls


@dataclass(frozen=True, slots=True)
class Proof:
    """The keys of a host. In the first of these `folders` that lets it, a newer revocation list is kept.

    For so many seconds the mission `lasts`: keys that end before that are refused. Whoever made the keys for
    this run alone vouches for the bundle `vouched`: its signature is not asked for.
    """

    keys: Keys
    folders: Sequence[Path] = ()
    lasts: float = 0.0
    vouched: Release = FROM_FILES


def insist_on_keys(host: str, hosts: Sequence[str]) -> None:
    """See that a host without keys has nobody to talk to. Raises UsageError."""
    if len(hosts) > 1:
        raise UsageError(
            f"{host} has no keys, and no host listens on a network without: give it the folder that "
            f"'lfield keys host {host}' makes, with --keys, $LFIELD_KEYS or as /etc/lfield/keys/{host} "
            "('lfield keys init' begins a team's authority); --all runs all hosts here, and needs none"
        )


def admitted(
    proof: Proof,
    host: str,
    clock: Clock,
    times: Collection[float],
    seen: Seen = lambda certificate, who: None,
) -> tuple[Tls, Judged]:
    """What carries the links of a host, and who may have one.

    `times` are those of its journal: it was so late already. One after the end of its keys is of a clock that
    was wrong, or they will be seen to have ended. `seen` hears of certificates as in `Tls`.

    Raises KeysError for keys of somebody else, that are revoked, or that end too soon.
    """
    tls = Tls(proof.keys, seen)
    own = tls.own()
    if (own.kind, own.name) != ("host", host):
        raise KeysError(
            f"these are the keys of {own}, not of host {host}: 'lfield keys host {host}' makes those"
        )
    revoked, data = newest_list(proof.keys, proof.folders)
    time = BelievedTime(clock, max((at for at in times if at < own.ends), default=0.0))
    admission = Judged(proof.keys, own, time, revoked, data)
    _insist_on_good(own, revoked, time.now(), proof.lasts)
    admission.keep = ListKeeper(proof.folders, admission).keep
    return tls, admission


def insist_on_signature(mission: Mission, proof: Proof, admission: Judged, kept: Collection[Page]) -> Taken:
    """The bundle of a mission with who has signed it, if this host takes it; `kept` is what its journal has.

    Raises SignatureError.
    """
    release = mission.release
    if release.digest and release.digest == proof.vouched.digest:
        return Taken(proof.vouched, "")
    return taken(
        release,
        proof.keys.authority,
        admission.own.authority,
        at=admission.time.now(),
        revoked=admission.revoked,
        runs=BundlePage(release.digest) in kept,
    )


def insist_on_all(mission: Mission, host: str, proof: Proof | None, clock: Clock) -> None:
    """See that a host may begin that has kept nothing yet, before there is anything of it.

    Raises UsageError, KeysError and SignatureError.
    """
    if proof is None:
        insist_on_keys(host, mission.team.hosts)
        return
    insist_on_signature(mission, proof, admitted(proof, host, clock, ())[1], ())


def _insist_on_good(own: Identity, revoked: Revoked, now: float, lasts: float) -> None:
    if own.serial in revoked.serials:
        raise KeysError(
            f"the keys of {own} are revoked (list {revoked.number}): make new ones with 'lfield keys {own}'"
        )
    if own.ends < now + lasts:
        raise KeysError(
            f"the certificate of {own} ends {when(own.ends)}, and the mission may last {lasts:.10g} s from "
            f"{when(now)} on: renew it with 'lfield keys renew {own}', or say with --lasts how long it takes"
        )
