"""What becomes of a fake's devices, written down by themselves: `--log FILE`.

The wire tells what a device says; this tells what it does, for whoever measures from outside: how long after
the death of a computer its devices are safe, say. A line for each change, first of all one for everything:

    1234.567890 3 mode=LAND

The time is CLOCK_MONOTONIC in seconds, which all processes of a computer share, when the fake had come to it:
never before it was so, and later by no more than one step of its model (see TICK in the servers). What became
so together has the same time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping

from lfield.errors import OutputFileError

#: What is so, by name: words, whole numbers, yes and no.
Facts = Mapping[str, str | int | bool]


class StateLog:
    """The log of one fake. `devices` tell what is so now, by their ids; without a path nothing is written."""

    def __init__(
        self,
        path: str,
        devices: Mapping[str, Callable[[], Facts]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._devices, self._clock = devices, clock
        self._known: dict[tuple[str, str], str] = {}
        try:
            # Written through, so that nothing is lost however the fake ends.
            self._file = open(path, "wb", buffering=0) if path else None  # noqa: SIM115
        except OSError as error:
            raise OutputFileError(path, error.strerror or str(error)) from None
        self.look()

    def look(self) -> None:
        """Write down what has changed since the last look. To be called whenever something may have."""
        if self._file is None:
            return
        seen = {
            (id, name): _word(value) for id, tell in self._devices.items() for name, value in tell().items()
        }
        changed = [fact for fact, word in seen.items() if self._known.get(fact) != word]
        if changed:
            now = self._clock()
            lines = "".join(f"{now:.6f} {id} {name}={seen[id, name]}\n" for id, name in changed)
            self._file.write(lines.encode())
            self._known.update(seen)

    def close(self) -> None:
        """Write no more."""
        if self._file is not None:
            self._file.close()
            self._file = None


def add_log_option(parser: argparse.ArgumentParser) -> None:
    """`--log FILE`."""
    parser.add_argument(
        "--log", default="", metavar="FILE", help="log file with one line per change: TIME DEVICE NAME=VALUE"
    )


def _word(value: str | int | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace(" ", "_")
