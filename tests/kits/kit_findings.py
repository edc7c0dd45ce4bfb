"""Failed and skipped checks of a kit."""

from __future__ import annotations


def failed(findings):
    """The failed checks, as readable lines."""
    return [f"{f.device}: {f.check}: {f.seen}" for f in findings.values() if f.outcome == "failed"]


def not_run(findings):
    """The checks that did not apply, by device."""
    return {key for key, finding in findings.items() if finding.outcome == "not run"}
