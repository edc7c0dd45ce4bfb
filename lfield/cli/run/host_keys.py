"""The keys of a host: from a directory, or ephemeral ones of `up --all`."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from lfield.authority.key_material import Keys
from lfield.errors import NoHomeFolder
from lfield.mission.access.signed_bundle import BundleId

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from lfield.host.process.credentials import HostCredentials
    from lfield.mission.mission import Mission


def load_credentials(host: str, args: argparse.Namespace) -> HostCredentials | None:
    """The credentials of the host; None without keys. Raises KeysError."""
    from lfield.authority import keystore
    from lfield.host.process.credentials import HostCredentials
    from lfield.text.user_dirs import state_dir

    if args.keys_fd is not None:
        inherited = _inherited(args.keys_fd)
        return HostCredentials(inherited.keys, accepted_bundle=inherited.bundle)
    found = keystore.find_keys("host", host, args.keys, os.environ)
    if found is None:
        return None
    folders = [found]
    with suppress(NoHomeFolder):
        # A service may only read its keys folder, so it stores its state elsewhere.
        folders.append(state_dir() / "keys" / keystore.entry_name(host))
    return HostCredentials(keystore.read_keys(found, "host"), folders, args.lasts)


def built_here(mission: Mission, path: Path, args: argparse.Namespace) -> Mission:
    """The mission with the signature that a host verifies.

    A signed bundle stays valid with other device bindings. A mission from files is signed now with the keys
    of a person who may sign; without them the host reports the missing signature.

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

    from lfield.authority import keystore
    from lfield.authority.bundle_signature import sign_bundle
    from lfield.errors import KeysError

    try:
        found = keystore.find_keys("person", keystore.OWN, args.keys, os.environ)
    except KeysError:
        # The named directory has the keys of the host only.
        return mission
    if found is None:
        return mission
    keys = keystore.read_keys(found, "person")
    try:
        signature = sign_bundle(mission.release.digest, keys, time.time())
    except KeysError:
        return mission
    return replace(
        mission, release=msgspec.structs.replace(mission.release, signature=signature, is_from_files=True)
    )


def observer_keys(host: str, args: argparse.Namespace) -> Keys | None:
    """The keys for queries to other hosts: this user's, else the host's. Raises KeysError."""
    from lfield.authority import keystore
    from lfield.errors import KeysError

    with suppress(KeysError):
        found = keystore.find_keys("person", keystore.OWN, args.keys, os.environ)
        if found is not None:
            return keystore.read_keys(found, "person")
    proof = load_credentials(host, args)
    return proof.keys if proof is not None else None


class _InheritedKeys(NamedTuple):
    """The keys and the bundle that `up --all` passes to a host."""

    keys: Keys
    bundle: BundleId


def ephemeral_keys(hosts: Iterable[str], bundle: BundleId) -> Mapping[str, int]:
    """New keys for each of these hosts, as file descriptors that a process can inherit.

    They are in memory only and end with the run. A process that has inherited such keys was started by this
    user to run this bundle; the descriptor contains its digest, which replaces a signature.
    """
    import time

    from lfield.authority.ephemeral_ca import EphemeralCa
    from lfield.net.tls import pipe_with

    now = time.time()
    authority = EphemeralCa.for_hosts(hosts, now)
    bundle = BundleId(bundle.digest, by="the user who started it", at=now)
    return {
        host: pipe_with(msgspec.msgpack.encode(_InheritedKeys(keys, bundle)))
        for host, keys in authority.hosts.items()
    }


def _inherited(descriptor: int) -> _InheritedKeys:
    with open(descriptor, "rb") as file:
        return msgspec.msgpack.decode(file.read(), type=_InheritedKeys)
