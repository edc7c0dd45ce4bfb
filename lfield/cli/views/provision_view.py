"""Progress of `lfield provision`: a line for each step, and in a terminal a table of the hosts."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence

from rich.live import Live
from rich.table import Table

from lfield.cli.views.team_state_view import add_row, new_table
from lfield.cli.views.trees import plain_console
from lfield.provision.host_provisioning import StepReport
from lfield.text.terminal_escape import escape_line

_LABELS = {
    "done": "ok",
    "running": "...",
    "changed": "done",
    "todo": "to do",
    "note": "NOTE",
    "refused": "REFUSED",
    "failed": "FAILED",
}
#: States of findings of doctor that are printed.
_SHOWN_FINDINGS = ("warning", "problem")


class ProvisionView:
    """Prints the reports of all hosts. Use as a context manager."""

    def __init__(self, hosts: Sequence[str], *, as_json: bool) -> None:
        self._as_json = as_json
        is_live = sys.stdout.isatty() and not as_json
        self._live = Live(console=plain_console(), auto_refresh=False, transient=True) if is_live else None
        self._last: dict[str, StepReport] = {}
        self._hosts, self._width = list(hosts), max(map(len, hosts), default=0)

    def __enter__(self) -> ProvisionView:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.update("", refresh=True)
            self._live.stop()

    def on_report(self, report: StepReport) -> None:
        """Print the new state of a step of a host."""
        before = self._last.get(report.host)
        self._last[report.host] = report
        if self._as_json:
            print(json.dumps(report.as_data()), flush=True)
            return
        # For a long step, each further line would only repeat the first.
        is_progress = report.state == "running" and before is not None and before.step == report.step
        if self._live:
            if report.state != "running":
                for line in self._lines(report):
                    self._live.console.print(line, soft_wrap=True)
            self._live.update(self._table(), refresh=True)
        elif not is_progress:
            for line in self._lines(report):
                print(line, flush=True)

    def _lines(self, report: StepReport) -> Iterable[str]:
        head = f"{report.host:<{self._width}} | {report.step:<11} {_LABELS[report.state]:<7}"
        yield escape_line(f"{head} {report.text}".rstrip())
        if report.advice:
            yield escape_line(f"{'':<{self._width}} |   -> {report.advice}")
        for finding in report.findings:
            if finding.get("state") in _SHOWN_FINDINGS:
                yield escape_line(f"{'':<{self._width}} |   {finding['state']}: {finding.get('message')}")
                if finding.get("hint"):
                    yield escape_line(f"{'':<{self._width}} |   -> {finding['hint']}")

    def _table(self) -> Table:
        table = new_table("HOST", "STEP", "STATE", "", unbroken=("HOST", "STEP", "STATE"))
        for host in self._hosts:
            report = self._last.get(host)
            if report is None:
                add_row(table, host, "", "waiting", "")
            else:
                add_row(table, host, report.step, _LABELS[report.state], report.text)
        return table


def print_summary(hosts: Sequence[str], provisioned: Sequence[str], seconds: float, *, is_dry: bool) -> None:
    """Print the last line: the number of finished hosts, and the others."""
    missing = [host for host in hosts if host not in provisioned]
    outcome = "could be planned" if is_dry else "done"
    tail = f"; not done: {', '.join(missing)}" if missing else ""
    print(escape_line(f"{len(provisioned)} of {len(hosts)} hosts {outcome} after {seconds:.0f} s{tail}"))
