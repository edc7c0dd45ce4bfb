"""A host as `lfield up` starts it, up to its first event."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.cli.run import up
from lfield.clock import SystemClock
from lfield.errors import KeysError
from lfield.host.host import Host


def does_host_start(bundle: Path, host: str, keys: Path, at: float, *more: str) -> bool:
    """Whether the command starts that host with these keys at a time, in seconds since 1970 UTC.

    A refusal is a KeysError: any other exception is raised.
    """
    started: list[str] = []

    async def live(host: Host, *_: object) -> int:
        started.append(host.name)
        return exit_status.DONE

    parser = argparse.ArgumentParser()
    up.add_arguments(parser)
    arguments = [str(bundle), "--host", host, "--keys", str(keys), "--volatile", *more]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lfield.host.process.host_process.run_until_exit", live)
        patch.setattr(SystemClock, "time", lambda clock: at)
        try:
            assert up.run(parser.parse_args(arguments)) == exit_status.DONE
        except KeysError:
            assert not started
            return False
    assert started == [host]
    return True
