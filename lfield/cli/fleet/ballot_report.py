"""Prints the progress and the result of a push or rollback: lines, a progress bar in a terminal, or JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.text.value_text import byte_count_text
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from lfield.errors import LfieldError
    from lfield.operator.fleet.activation import BallotResult
    from lfield.operator.fleet.bundle_upload import UploadProgress


class PushReport:
    """The report about one bundle. With `as_json` one object is printed at the end, and no lines."""

    def __init__(self, digest: bytes, *, as_json: bool) -> None:
        self._digest, self._as_json = digest, as_json
        self._data: dict[str, object] = {"bundle": digest.hex()}
        self._progress: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._deferred: set[str] = set()

    def start(self, text: str) -> None:
        """Print the bundle that is pushed, and start the progress bars in a terminal."""
        self._print(text)
        if not self._as_json and sys.stderr.isatty():
            from rich.progress import BarColumn, Progress, TextColumn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed}/{task.total}"),
            )
            self._progress = Progress(*columns, transient=True)
            self._progress.start()

    def on_progress(self, host: str, progress: UploadProgress) -> None:
        """Show that more pieces are stored on a host, or that it stores other bundles first."""
        if progress.is_deferred and host not in self._deferred:
            self._deferred.add(host)
            self._print(f"{host}: waits: {progress.refusal}", error=True)
        if self._progress is not None:
            if host not in self._tasks:
                self._tasks[host] = self._progress.add_task(host, total=progress.total)
            self._progress.update(self._tasks[host], completed=progress.stored)

    def on_sent(self, sent: Mapping[str, UploadProgress], size: int) -> None:
        """Called when all transfers have ended."""
        if self._progress is not None:
            self._progress.stop()
        self._data["sent"] = {
            host: {"bytes": each.sent, "links": each.attempts, "refusal": each.refusal, "code": each.code}
            for host, each in sent.items()
        }
        self._data["size"] = size
        for host, each in sent.items():
            if each.refusal:
                self._print(f"{host}: refused: {each.refusal}", error=True)
            elif each.sent:
                self._print(f"{host}: stored, {byte_count_text(each.sent)} of {byte_count_text(size)} sent")
            else:
                self._print(f"{host}: stored, already there")

    def on_refusals(self, reasons: Mapping[str, str], silent: Mapping[str, LfieldError]) -> int:
        """Print the hosts that would vote no, or do not answer, so that there was no vote; returns the
        status.
        """
        self._data |= {"votes": {}, "reasons": dict(reasons)}
        for host, reason in reasons.items():
            self._print(f"{host}: refuses: {reason}", error=True)
        self.finish("aborted", silent, "nothing was activated: all hosts have to agree")
        return exit_status.FAILED if reasons else exit_status.UNAVAILABLE

    def on_result(self, result: BallotResult) -> int:
        """Print the result of the vote; returns the exit status."""
        hosts = result.ballot.hosts
        self._data |= {"votes": result.votes, "reasons": result.reasons}
        bundle = short_digest(self._digest)
        match result.outcome:
            case "activated":
                uninformed = [host for host in hosts if host not in result.informed]
                late = f"; {listed(uninformed)} will learn it from the others" if uninformed else ""
                self.finish("activated", {}, f"bundle {bundle} active on {listed(hosts)}{late}")
                return exit_status.DONE
            case "aborted":
                for host, reason in result.reasons.items():
                    late = f" ({result.late[host]})" if host in result.late else ""
                    self._print(f"{host}: votes no: {reason}{late}", error=True)
                self.finish("aborted", result.unreached, "nothing was activated: all hosts have to agree")
                return exit_status.FAILED
        for host, error in result.unreached.items():
            self._print(f"{host}: no vote: {error}", error=True)
        self.finish(
            "open",
            result.unreached,
            f"no result yet: the votes of {listed(result.missing)} are unknown. The other hosts start "
            "nothing until they know these votes; 'lfield status' shows the result",
        )
        return exit_status.UNKNOWN_OUTCOME

    def finish(self, outcome: str, failed: Mapping[str, LfieldError], text: str) -> None:
        """Print the last line, or the JSON object."""
        self._print(text, error=outcome in ("aborted", "open") or bool(failed))
        if self._as_json:
            errors = {host: error.as_data() for host, error in failed.items()}
            print(json.dumps({**self._data, "outcome": outcome, "errors": errors, "text": text}))

    def _print(self, text: str, *, error: bool = False) -> None:
        if not self._as_json:
            print(escape_line(text), file=sys.stderr if error else sys.stdout, flush=True)
