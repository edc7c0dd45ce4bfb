"""Log of the true states of simulated devices: `--log FILE`.

The wire shows the reports of a device; this log shows its actual state, for external measurements: for
example the time from the failure of a computer until its devices are safe. A line per change, starting with
everything:

1234.567890 3 mode=LAND

The time is CLOCK_MONOTONIC in seconds, common to all processes of a computer, when the simulated device had
processed it: at most one step of its model late (see TICK in the servers). Simultaneous changes have the same
time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping

from lfield.errors import OutputFileError

#: True values by name: words, integers, booleans.
Facts = Mapping[str, str | int | bool]


class StateLog:
    """The log of one simulated device. `devices` return present values, by id; without a path nothing is
    written."""

    def __init__(
        self,
        path: str,
        devices: Mapping[str, Callable[[], Facts]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._devices, self._clock = devices, clock
        self._written: dict[tuple[str, str], str] = {}
        try:
            # Unbuffered, so that no line is lost however the simulated device ends.
            self._file = open(path, "wb", buffering=0) if path else None  # noqa: SIM115  # closed by `close`
        except OSError as error:
            raise OutputFileError(path, error.strerror or str(error)) from None
        self.write_changes()

    def write_changes(self) -> None:
        """Writes changes since the last call. Called whenever a value may have changed."""
        if self._file is None:
            return
        values = {
            (id, name): _value_text(value)
            for id, read_state in self._devices.items()
            for name, value in read_state().items()
        }
        changed = [fact for fact, value in values.items() if self._written.get(fact) != value]
        if changed:
            now = self._clock()
            lines = "".join(f"{now:.6f} {id} {name}={values[id, name]}\n" for id, name in changed)
            self._file.write(lines.encode())
            self._written.update(values)

    def close(self) -> None:
        """Closes the log."""
        if self._file is not None:
            self._file.close()
            self._file = None


def add_log_option(parser: argparse.ArgumentParser) -> None:
    """Adds `--log FILE`."""
    parser.add_argument(
        "--log", default="", metavar="FILE", help="log file with one line per change: TIME DEVICE NAME=VALUE"
    )


def _value_text(value: str | int | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace(" ", "_")
