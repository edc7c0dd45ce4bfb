"""The planner in its own process: `python -m lfield_planner.worker` answers each line by a line.

It computes for seconds, which a guard must never wait for. A process can be killed; a thread cannot.
"""

from __future__ import annotations

import os
import sys
from typing import TextIO


def own_output() -> TextIO:
    """Standard output for our lines only: output of libraries, such as HiGHS's name, goes to stderr."""
    ours = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    return ours


def main() -> None:
    """Serves until the end of stdin."""
    output = own_output()
    # Imported here: it takes a moment.
    from lfield_planner.planning import answer

    for line in sys.stdin:
        print(answer(line), file=output, flush=True)


if __name__ == "__main__":
    main()
