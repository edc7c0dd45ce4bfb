"""The keys that `lfield up` runs a host with: of a folder, or those that `up --all` has made for its run."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from lfield.authority.keys import Keys
from lfield.errors import NoHome
from lfield.mission.access.release import Release

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from lfield.host.process.proving import Proof
    from lfield.mission.mission import Mission


def proof_of(host: str, args: argparse.Namespace) -> Proof | None:
    """With what the host proves who it is; None where there are no keys. Raises KeysError."""
    from lfield.authority import folder
    from lfield.host.process.proving import Proof
    from lfield.text.own_folders import state_folder

    if args.keys_fd is not None:
        given = _inherited(args.keys_fd)
        return Proof(given.keys, vouched=given.bundle)
    found = folder.find("host", host, args.keys, os.environ)
    if found is None:
        return None
    folders = [found]
    with suppress(NoHome):
        # A service may read its keys, and write what it has to keep elsewhere.
        folders.append(state_folder() / "keys" / folder.inside_name(host))
    return Proof(folder.read(found, "host"), folders, args.lasts)


def built_here(mission: Mission, path: Path, args: argparse.Namespace) -> Mission:
    """A mission that was built just now, of a bundle or of files, as what a host takes it for.

    A bundle that gets this computer's own devices is the one that was signed. What is of files, whoever may
    sign bundles has signed by having it run; without such keys a host says what is missing. No other computer
    has to have made the same of its own files.

    Raises KeysError for keys that cannot be used.
    """
    from lfield.mission import bundle

    if path.suffix != bundle.SUFFIX:
        return _signed(mission, args)
    whole = bundle.read(path)
    alike = [(m.program.digest, m.team.deployment, m.access.digest) for m in (whole, mission)]
    return replace(mission, release=whole.release) if alike[0] == alike[1] else mission


def _signed(mission: Mission, args: argparse.Namespace) -> Mission:
    import time

    from lfield.authority import folder
    from lfield.authority.signature import sign
    from lfield.errors import KeysError

    try:
        found = folder.find("person", folder.ME, args.keys, os.environ)
    except KeysError:
        # What is named has the keys of the host alone.
        return mission
    if found is None:
        return mission
    keys = folder.read(found, "person")
    try:
        signature = sign(mission.release.digest, keys, time.time())
    except KeysError:
        return mission
    return replace(mission, release=replace(mission.release, signature=signature, of_files=True))


def keys_for_asking(host: str, args: argparse.Namespace) -> Keys | None:
    """What somebody asks the others with who starts a host: this user's keys, else the host's.

    Raises KeysError.
    """
    from lfield.authority import folder
    from lfield.errors import KeysError

    with suppress(KeysError):
        found = folder.find("person", folder.ME, args.keys, os.environ)
        if found is not None:
            return folder.read(found, "person")
    proof = proof_of(host, args)
    return proof.keys if proof is not None else None


class _Given(NamedTuple):
    """What a host is given that was started with all others: its keys, and the bundle that is to run."""

    keys: Keys
    bundle: Release


def minted(hosts: Iterable[str], bundle: Release) -> Mapping[str, int]:
    """New keys for each of these hosts, known to nobody else: descriptors that a process can inherit.

    They are in memory only, and gone with the processes of the run. Whoever has such keys was started by this
    user to run this bundle: that is in the descriptor too, and says as much as a signature.
    """
    import time

    import msgspec

    from lfield.authority.minted import Minted
    from lfield.net.tls import piped

    now = time.time()
    made = Minted.for_hosts(hosts, now)
    bundle = Release(bundle.digest, by="whoever started it", at=now)
    return {host: piped(msgspec.msgpack.encode(_Given(keys, bundle))) for host, keys in made.hosts.items()}


def _inherited(descriptor: int) -> _Given:
    import msgspec

    with open(descriptor, "rb") as file:
        return msgspec.msgpack.decode(file.read(), type=_Given)
