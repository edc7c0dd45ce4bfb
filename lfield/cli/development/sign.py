"""`lfield sign`: signs a bundle; the signature is stored in its file."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

from lfield.errors import KeysError, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="BUNDLE", type=Path, help="bundle (.lfm), signed in place")
    parser.add_argument(
        "--keys",
        metavar="DIR",
        type=Path,
        help="directory with your keys (default: $LFIELD_KEYS, or ~/.config/lfield/keys/me)",
    )


def run(args: argparse.Namespace) -> int:
    """Sign the bundle; an existing signature is replaced, the digest is unchanged."""
    from lfield.authority.bundle_signature import sign_bundle, verify_bundle
    from lfield.authority.keystore import OWN, find_keys, read_keys
    from lfield.cli.output_files import write_bytes
    from lfield.errors import BundleError
    from lfield.mission import bundle
    from lfield.wire.fields import short_digest

    if args.file.suffix != bundle.SUFFIX:
        raise UsageError(f"{args.file} is not a bundle: 'lfield build' makes one from a deployment")
    data = bundle.read_file(args.file)
    try:
        # A bundle that hosts would refuse is not signed.
        bundle.decode(data)
    except BundleError as error:
        raise error.of(args.file) from None
    folder = find_keys("person", OWN, args.keys, os.environ)
    if folder is None:
        raise KeysError(
            "no keys of yours on this computer: create them with 'lfield keys person NAME --may command', "
            "and name their directory with --keys or copy them to ~/.config/lfield/keys/me"
        )
    keys = read_keys(folder, "person")
    digest = bundle.contents(data).digest
    signature = sign_bundle(digest, keys, time.time())
    write_bytes(args.file, bundle.with_signature(data, signature))
    identity = verify_bundle(digest, signature, keys.authority).identity
    print(f"{args.file}: bundle {short_digest(digest)}, signed by {identity}", file=sys.stderr)
    return 0
