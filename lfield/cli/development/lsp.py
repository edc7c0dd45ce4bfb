"""`lfield lsp`: a language server for programs and deployments, on stdin and stdout."""

from __future__ import annotations

import argparse
import logging

from lfield import exit_status
from lfield.errors import PluginError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options: those that some editors add to the command of every server."""
    parser.add_argument("--stdio", action="store_true", help="accepted: stdin and stdout are always used")


def run(args: argparse.Namespace) -> int:
    """Serve until the editor ends the session. Raises PluginError where pygls is not installed."""
    try:
        from lfield.editor.language_server import LfieldServer
    except ImportError:
        raise PluginError("'lfield lsp' needs pygls: pip install 'lfield[desk]'") from None
    from lfield.editor.installed import DiskFiles, InstalledEnvironment
    from lfield.editor.workspace import Workspace

    # The messages of pygls about lost connections are for its developers.
    logging.getLogger("pygls").setLevel(logging.CRITICAL)
    server = LfieldServer(Workspace(DiskFiles(), InstalledEnvironment())).server
    # The streams of Python escape characters.
    with open(0, "rb", closefd=False) as source, open(1, "wb", closefd=False) as sink:
        server.start_io(source, sink)
    return exit_status.DONE
