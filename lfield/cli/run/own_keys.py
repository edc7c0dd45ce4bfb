"""The keys that `lfield up` runs a host with: of a folder, or those that `up --all` has made for its run."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lfield.authority.keys import Keys
    from lfield.host.process.proving import Proof


def proof_of(host: str, args: argparse.Namespace) -> Proof | None:
    """With what the host proves who it is; None where there are no keys. Raises KeysError."""
    from lfield.authority import folder
    from lfield.host.process.proving import Proof
    from lfield.text.private import state_folder

    if args.keys_fd is not None:
        return Proof(_inherited(args.keys_fd))
    found = folder.find("host", host, args.keys, os.environ)
    if found is None:
        return None
    # A service may read its keys, and write what it has to keep elsewhere.
    kept = state_folder() / "keys" / folder.inside_name(host)
    return Proof(folder.read(found, "host"), (found, kept), args.lasts)


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


def minted(hosts: Iterable[str]) -> Mapping[str, int]:
    """New keys for each of these hosts, known to nobody else: descriptors that a process can inherit.

    They are in memory only, and gone with the processes of the run.
    """
    import time

    import msgspec

    from lfield.authority.minted import Minted
    from lfield.net.tls import piped

    made = Minted.for_hosts(hosts, time.time())
    return {host: piped(msgspec.msgpack.encode(keys)) for host, keys in made.hosts.items()}


def _inherited(descriptor: int) -> Keys:
    import msgspec

    from lfield.authority.keys import Keys

    with open(descriptor, "rb") as file:
        return msgspec.msgpack.decode(file.read(), type=Keys)
