"""The kernels of first_second.L in Python: `first_second_kernels.py NAME SIZE` prints the result of one."""

from __future__ import annotations

import sys
from collections.abc import Callable


def ints(n: int) -> int:
    """A loop of ints."""
    x = 1
    for i in range(n):
        x = (x * 31 + i) % 65521
    return x


def reals(n: int) -> int:
    """A loop of reals."""
    y = 0.0
    for i in range(n):
        y = y * 0.5 + i
    return int(y)


def arrays(n: int) -> int:
    """Reads and writes of an array: n times the sieve of Eratosthenes."""
    primes = 0
    for _ in range(n):
        crossed = [False] * 10001
        primes = 0
        i = 2
        while i <= 10000:
            if not crossed[i]:
                primes = primes + 1
                k = i + i
                while k <= 10000:
                    crossed[k] = True
                    k = k + i
            i = i + 1
    return primes


def calls(n: int) -> int:
    """Calls of a recursive function."""
    if n < 2:
        return n
    return calls(n - 1) + calls(n - 2)


KERNELS: dict[str, Callable[[int], int]] = {"ints": ints, "reals": reals, "arrays": arrays, "calls": calls}
#: Each takes CPython about a second.
SIZES = {"ints": 12_000_000, "reals": 17_000_000, "arrays": 750, "calls": 34}

if __name__ == "__main__":
    print(sys.argv[1], KERNELS[sys.argv[1]](int(sys.argv[2])))
