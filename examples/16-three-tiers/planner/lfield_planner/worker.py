"""The planner's process: `python -m lfield_planner.worker` answers each line of stdin with a line of stdout.

A plan needs seconds, and the guard's event loop must not block. A process can be killed; a thread cannot.
"""

from __future__ import annotations

import os
import sys
from typing import TextIO


def own_output() -> TextIO:
    """Standard output for answers only; the output of libraries, such as HiGHS, is redirected to stderr."""
    output = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    return output


def main() -> None:
    """Answers requests until the end of stdin."""
    output = own_output()
    # Imported after the redirection, because the import may print.
    from lfield_planner.planning import answer

    for line in sys.stdin:
        print(answer(line), file=output, flush=True)


if __name__ == "__main__":
    main()
