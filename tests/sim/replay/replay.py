"""`python tests/sim/replay/replay.py [--write] [TRACE ...]`: differences of recordings, with their reasons.

TRACE is a name or the beginning of one (`ap-copter.c`); without any all are played. `--write` brings the
table up to date: what is gone goes, what is new comes with the reason "to be mended".
"""

from __future__ import annotations

import argparse
import fnmatch
import time
from dataclasses import dataclass
from pathlib import Path

import yaml
from replay_compare import Difference, differences
from replay_player import play
from replay_trace import names, read

TABLE = Path(__file__).parent / "differences.yaml"
#: The reason of what nobody has mended yet.
TO_BE_MENDED = "to be mended"
HEAD = """\
# Where the fake differs from the recordings: trace -> reason -> differences (patterns with * and ?).
# A trace may be a pattern too. Brought up to date by `python tests/sim/replay/replay.py --write`.
"""

Table = dict[str, dict[str, list[str]]]


@dataclass
class Verdict:
    """Of one recording: what is different and not listed, and what is listed and is not there any more."""

    found: list[Difference]
    unlisted: list[Difference]
    stale: list[str]


def load() -> Table:
    """The table of differences that stay."""
    return yaml.safe_load(TABLE.read_text(encoding="utf-8")) or {} if TABLE.exists() else {}


def judge(name: str, table: Table) -> Verdict:
    """One recording held against the table."""
    trace = read(name)
    found = differences(trace, play(trace))
    patterns = [p for reasons in (table.get(name) or {}).values() for p in reasons]
    common = [p for t, reasons in table.items() if "*" in t and fnmatch.fnmatchcase(name, t)
              for listed in reasons.values() for p in listed]  # fmt: skip
    unlisted = [each for each in found if not any(matches(each, p) for p in [*patterns, *common])]
    stale = [p for p in patterns if not any(matches(each, p) for each in found)]
    return Verdict(found, unlisted, stale)


def matches(difference: Difference, pattern: str) -> bool:
    """Whether a listed pattern is about this difference; `[` is no pattern."""
    return fnmatch.fnmatchcase(difference.key, pattern.replace("[", "[[]"))


def reason(name: str, difference: Difference, table: Table) -> str:
    """Why a difference stays, "" when it is not listed."""
    for trace, reasons in table.items():
        if trace == name or ("*" in trace and fnmatch.fnmatchcase(name, trace)):
            for why, listed in reasons.items():
                if any(matches(difference, p) for p in listed):
                    return why
    return ""


def renew(table: Table, name: str, verdict: Verdict) -> None:
    """Put what is new into the table and take out what is gone."""
    kept = {
        why: [p for p in listed if p not in verdict.stale] for why, listed in (table.get(name) or {}).items()
    }
    kept.setdefault(TO_BE_MENDED, []).extend(each.key.replace("*", "?") for each in verdict.unlisted)
    kept = {why: listed for why, listed in kept.items() if listed}
    table.pop(name, None)
    if kept:
        table[name] = kept


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Play recordings to the fake.")
    parser.add_argument("traces", nargs="*")
    parser.add_argument("--write", action="store_true", help="bring the table up to date")
    args = parser.parse_args()
    table, begun, count, left = load(), time.monotonic(), 0, 0
    for name in names():
        if args.traces and not any(name.startswith(wanted) for wanted in args.traces):
            continue
        verdict = judge(name, table)
        count, left = count + 1, left + len(verdict.found)
        print(
            f"{name}: {len(verdict.found)} differences, "
            f"{len(verdict.unlisted)} not listed, {len(verdict.stale)} stale"
        )
        for each in verdict.found if args.traces else ():
            print(f"  {each.key}  {each.detail}  [{reason(name, each, table) or 'NOT LISTED'}]")
        for each in verdict.stale if args.traces else ():
            print(f"  listed and gone: {each}")
        if args.write:
            renew(table, name, verdict)
    if args.write:
        table = {name: table[name] for name in sorted(table)}
        TABLE.write_text(
            HEAD + yaml.safe_dump(table, sort_keys=False, width=200, allow_unicode=True), encoding="utf-8"
        )
    print(f"{count} traces, {left} differences, {time.monotonic() - begun:.1f} s")


if __name__ == "__main__":
    main()
