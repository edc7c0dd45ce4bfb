"""`python tests/sim/replay/replay.py [--write] [TRACE ...]`: differences of recordings, with their reasons.

TRACE is a name or the start of one (`ap-copter.c`); without one, all are played. `--write` updates the table:
it removes entries that no longer occur, adds new ones with the reason "to be mended", and writes new figures.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import yaml
from replay_compare import differences
from replay_player import play
from replay_table import Table, Verdict, judge, reason, renew
from replay_trace import names, read

TABLE = Path(__file__).parent / "differences.yaml"
HEAD = """\
# Where the fake differs from the recordings: trace -> reason -> differences (patterns with * and ?).
# A trace may be a pattern too. Behind a difference that is measured stands by how much, real / fake: no
# further may it go. Brought up to date by `python tests/sim/replay/replay.py --write`.
"""


def load() -> Table:
    """The table of known differences."""
    return yaml.safe_load(TABLE.read_text(encoding="utf-8")) or {} if TABLE.exists() else {}


def save(table: Table) -> None:
    """Writes the table, sorted by recording."""
    table = {name: table[name] for name in sorted(table)}
    text = yaml.safe_dump(table, sort_keys=False, width=200, allow_unicode=True)
    TABLE.write_text(HEAD + text, encoding="utf-8")


def verdict(name: str, table: Table) -> Verdict:
    """Plays one recording to the fake and compares the differences with the table."""
    trace = read(name)
    return judge(name, differences(trace, play(trace)), table)


def show(name: str, found: Verdict, table: Table) -> None:
    """Prints the differences of one recording."""
    for each in found.found:
        print(f"  {each.entry}  {each.detail}  [{reason(name, each, table) or 'NOT LISTED'}]")
    for text in found.stale:
        print(f"  listed and gone: {text}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Play recordings to the fake.")
    parser.add_argument("traces", nargs="*")
    parser.add_argument("--write", action="store_true", help="bring the table up to date")
    args = parser.parse_args()
    table, started, count, left = load(), time.monotonic(), 0, 0
    for name in names():
        if args.traces and not any(name.startswith(prefix) for prefix in args.traces):
            continue
        found = verdict(name, table)
        count, left = count + 1, left + len(found.found)
        print(
            f"{name}: {len(found.found)} differences, {len(found.unlisted)} not listed, "
            f"{len(found.worse)} worse, {len(found.stale)} stale"
        )
        for text in found.worse:
            print(f"  worse: {text}")
        if args.traces:
            show(name, found, table)
        if args.write:
            renew(table, name, found)
    if args.write:
        save(table)
    print(f"{count} traces, {left} differences, {time.monotonic() - started:.1f} s")


if __name__ == "__main__":
    main()
