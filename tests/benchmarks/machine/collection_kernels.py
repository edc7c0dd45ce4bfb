"""The programs of collections.L in Python, with its lists and dicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cmp_to_key


@dataclass(slots=True)
class Item:
    """An object to sort."""

    number: int
    far: float


def append(n: int) -> int:
    """Append and pop."""
    a: list[int] = []
    for i in range(n):
        a.append(i)  # each call is measured
    total = 0
    while len(a) > 0:
        total += a.pop()
    return total


def queue(n: int) -> int:
    """Remove the first, append."""
    a: list[int] = []
    total = 0
    for i in range(50):
        a.append(i)  # as above
    for i in range(n):
        first = a.pop(0)
        total += first
        a.append((first * 7 + i) % 1000)
    return total


def insert(n: int) -> int:
    """Insert in the middle."""
    a: list[int] = []
    for i in range(n):
        a.insert(len(a) // 2, i)
    return a[0] + a[n // 2] + a[n - 1]


def contains(n: int) -> int:
    """Search."""
    a: list[int] = []
    for i in range(n):
        a.append(i * 3)  # as above
    found = 0
    for i in range(n):
        if i in a:
            found += 1
    return found


def sort(n: int) -> int:
    """Sort numbers."""
    a: list[int] = []
    x = 1
    for i in range(n):
        x = (x * 31 + i) % 65521
        a.append(x)
    a.sort()
    return a[0] + a[n // 2] * 3 + a[n - 1]


def _items(n: int) -> list[Item]:
    a: list[Item] = []
    x = 1
    for i in range(n):
        x = (x * 31 + i) % 65521
        a.append(Item(i, x / 7))
    return a


def _far(one: Item) -> float:
    return one.far


def _nearer(one: Item, other: Item) -> int:
    return -1 if one.far < other.far else 1 if other.far < one.far else 0


def sort_by_key(n: int) -> int:
    """Sort objects by a key."""
    a = _items(n)
    a.sort(key=_far)
    return a[0].number + a[n // 2].number * 3 + a[n - 1].number


def sort_by_comparison(n: int) -> int:
    """Sort objects by a comparison."""
    a = _items(n)
    a.sort(key=cmp_to_key(_nearer))
    return a[0].number + a[n // 2].number * 3 + a[n - 1].number


def ints(n: int) -> int:
    """A map from ints: add, read, remove."""
    m: dict[int, int] = {}
    total = 0
    for i in range(n):
        m[i * 7] = i
    for i in range(n):
        total += m[i * 7]
    for i in range(0, n, 2):
        total += m.pop(i * 7)
    return total + len(m)


def strings(n: int) -> int:
    """A map from strings: add, change, read."""
    m: dict[str, int] = {}
    names: list[str] = []
    for i in range(n):
        names.append("robot-" + str(i))  # as above
    total = 0
    for name in names:
        m[name] = total
    for _ in range(3):
        for name in names:
            m[name] += 1
    for name in names:
        total += m[name]
    return total


def loop(n: int) -> int:
    """Keys and values in order."""
    m: dict[int, int] = {}
    for i in range(n):
        m[i] = i
    total = 0
    for _ in range(10):
        for key in m:
            total += key
        for value in m.values():
            total += value
    return total


#: With the sizes of collections.L, in its order.
KERNELS: dict[str, Callable[[], int]] = {
    "append": lambda: append(10000),
    "queue": lambda: queue(2000),
    "insert": lambda: insert(1000),
    "contains": lambda: contains(500),
    "sort": lambda: sort(2000),
    "sort by key": lambda: sort_by_key(1000),
    "sort by comparison": lambda: sort_by_comparison(500),
    "map of ints": lambda: ints(2000),
    "map of strings": lambda: strings(1000),
    "map loop": lambda: loop(1000),
}
