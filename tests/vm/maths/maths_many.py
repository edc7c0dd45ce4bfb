"""Compare WebAssembly with Python, for millions of arguments.

python tests/vm/maths/maths_many.py [COUNT] [SEED]
"""

from __future__ import annotations

import sys
import time

from maths_values import Lowered, arguments, differing

from lfield.vm.maths.intrinsics import MATHS

#: Arguments of one batch.
BATCH = 100_000


def main(count: int, seed: int) -> int:
    """Compare that many arguments for each function; print a line for each, and the differences."""
    lowered, wrong = Lowered(), 0
    for name in MATHS:
        started, found = time.monotonic(), []
        for number in range(0, count, BATCH):
            values = arguments(name, min(BATCH, count - number), seed + number)
            found += differing(lowered, name, values)
        wrong += len(found)
        print(
            f"{name:10} {count:9} arguments, {len(found)} differ, {time.monotonic() - started:.1f} s",
            flush=True,
        )
        print("\n".join(found[:5]), end="\n" if found else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*(int(word) for word in sys.argv[1:] or ["100000"]), *([1] if len(sys.argv) < 3 else [])))
