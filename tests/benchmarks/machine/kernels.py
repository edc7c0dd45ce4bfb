"""The ten programs of kernels.L in Python, the same way, statement by statement."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt


class Tree:
    """A binary tree."""

    def __init__(self, depth: int) -> None:
        self.left: Tree | None = None
        self.right: Tree | None = None
        if depth > 0:
            self.left = Tree(depth - 1)
            self.right = Tree(depth - 1)

    def count(self) -> int:
        """Its nodes."""
        if self.left is None or self.right is None:
            return 1
        return 1 + self.left.count() + self.right.count()


class Link:
    """A linked list."""

    def __init__(self, number: int, rest: Link | None) -> None:
        self.number = number
        self.next = rest


class Body:
    """A mass in the plane."""

    def __init__(self, x: float, y: float, vx: float, vy: float, mass: float) -> None:
        self.x, self.y, self.vx, self.vy, self.mass = x, y, vx, vy, mass


def fib(n: int) -> int:
    """Calls and int arithmetic."""
    if n < 2:
        return n
    return fib(n - 1) + fib(n - 2)


def sieve(n: int) -> int:
    """Loops and array elements."""
    crossed = [False] * (n + 1)
    primes = 0
    i = 2
    while i <= n:
        if not crossed[i]:
            primes = primes + 1
            k = i + i
            while k <= n:
                crossed[k] = True
                k = k + i
        i = i + 1
    return primes


def _filled(n: int) -> list[list[float]]:
    return [[float(i - j) for j in range(n)] for i in range(n)]


def matrix(n: int) -> int:
    """Nested loops and reals."""
    a = _filled(n)
    b = _filled(n)
    trace = 0.0
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total = total + a[i][k] * b[k][j]
            if i == j:
                trace = trace + total
    return int(trace)


def trees(depth: int, many: int) -> int:
    """Objects that are soon garbage."""
    nodes = 0
    for _ in range(many):
        tree = Tree(depth)
        nodes = nodes + tree.count()
    return nodes


def links(length: int, walks: int) -> int:
    """References from object to object."""
    first: Link | None = None
    for i in range(length):
        first = Link(i, first)
    total = 0
    for _ in range(walks):
        link = first
        while link is not None:
            total = total + link.number
            link = link.next
    return total


def bodies(count: int, steps: int) -> int:
    """Reals in fields of objects."""
    everything = [Body(i * 2.0, i * i * 0.5, 0.1 * i, 0.0 - 0.05 * i, 1.0 + i) for i in range(count)]
    for _ in range(steps):
        for i in range(count):
            a = everything[i]
            for j in range(i + 1, count):
                b = everything[j]
                dx = a.x - b.x
                dy = a.y - b.y
                square = dx * dx + dy * dy + 0.01
                pull = 0.001 / (square * sqrt(square))
                a.vx = a.vx - dx * b.mass * pull
                a.vy = a.vy - dy * b.mass * pull
                b.vx = b.vx + dx * a.mass * pull
                b.vy = b.vy + dy * a.mass * pull
        for a in everything:
            a.x = a.x + a.vx * 0.001
            a.y = a.y + a.vy * 0.001
    return int(everything[0].x * 1000000.0) + int(everything[count - 1].y * 1000000.0)


def mandelbrot(side: int, most: int) -> int:
    """Real arithmetic in local variables."""
    total = 0
    for row in range(side):
        for column in range(side):
            cx = 3.0 * column / side - 2.0
            cy = 2.0 * row / side - 1.0
            x = 0.0
            y = 0.0
            n = 0
            while n < most and x * x + y * y < 4.0:
                following = x * x - y * y + cx
                y = 2.0 * x * y + cy
                x = following
                n = n + 1
            total = total + n
    return total


def _safe(columns: list[int], row: int, column: int) -> bool:
    for i in range(row):
        other = columns[i]
        if other == column or other - column == row - i or column - other == row - i:
            return False
    return True


def _place(columns: list[int], row: int, n: int) -> int:
    if row == n:
        return 1
    found = 0
    for column in range(n):
        if _safe(columns, row, column):
            columns[row] = column
            found = found + _place(columns, row + 1, n)
    return found


def queens(n: int) -> int:
    """Calls with an array, loops and conditions."""
    return _place([0] * n, 0, n)


def sort(n: int) -> int:
    """Reads and writes of an array."""
    numbers = [0] * n
    seed = 42
    for i in range(n):
        seed = (seed * 1103 + 12345) % 65536
        numbers[i] = seed
    for i in range(1, n):
        number = numbers[i]
        k = i - 1
        while k >= 0 and numbers[k] > number:
            numbers[k + 1] = numbers[k]
            k = k - 1
        numbers[k + 1] = number
    return numbers[0] + numbers[n // 2] + numbers[n - 1]


def text(n: int) -> int:
    """Strings made, searched and read."""
    total = 0
    for i in range(n):
        words = "agent " + str(i) + " of " + str(n)
        total = total + len(words) + words.find("of") + int(words[6 : words.find(" of")])
    return total


#: With the sizes of kernels.L, in its order.
KERNELS: dict[str, Callable[[], int]] = {
    "fib": lambda: fib(18),
    "sieve": lambda: sieve(12000),
    "matrix": lambda: matrix(22),
    "trees": lambda: trees(7, 20),
    "links": lambda: links(800, 20),
    "bodies": lambda: bodies(5, 60),
    "mandelbrot": lambda: mandelbrot(28, 60),
    "queens": lambda: queens(6),
    "sort": lambda: sort(250),
    "text": lambda: text(1200),
}
