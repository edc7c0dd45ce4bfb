"""The ten programs of kernels.L in Python, statement by statement."""

from __future__ import annotations

from collections.abc import Callable


class Tree:
    """A binary tree."""

    def __init__(self, depth: int) -> None:
        self.left: Tree | None = None
        self.right: Tree | None = None
        if depth > 0:
            self.left = Tree(depth - 1)
            self.right = Tree(depth - 1)

    def count(self) -> int:
        """The number of nodes."""
        if self.left is None or self.right is None:
            return 1
        return 1 + self.left.count() + self.right.count()


class Link:
    """A linked list."""

    def __init__(self, number: int, rest: Link | None) -> None:
        self.number = number
        self.next = rest


class Queue:
    """A first-in, first-out queue."""

    def __init__(self) -> None:
        self.first: Link | None = None
        self.last: Link | None = None

    def put(self, number: int) -> None:
        """Add a number at the end."""
        link = Link(number, None)
        if self.last is None:
            self.first = link
        else:
            self.last.next = link
        self.last = link

    def take(self) -> int:
        """Remove and return the first number."""
        link = self.first
        self.first = link.next  # type: ignore[union-attr]  # not empty
        if self.first is None:
            self.last = None
        return link.number  # type: ignore[union-attr]  # as above


class Counter:
    """An object with five methods to call."""

    def __init__(self) -> None:
        self.value = self.turns = 0

    def add(self, number: int) -> None:
        """Adds."""
        self.value = self.value + number

    def subtract(self, number: int) -> None:
        """Subtracts."""
        self.value = self.value - number

    def halve(self) -> None:
        """Halves, towards zero as L does."""
        self.value = self.value // 2 if self.value >= 0 else -(-self.value // 2)

    def swap(self) -> None:
        """Exchanges value and turns."""
        kept = self.value
        self.value = self.turns
        self.turns = kept

    def turn(self) -> None:
        """Counts."""
        self.turns = self.turns + 1


def loop(n: int) -> int:
    """A loop with arithmetic."""
    x = 1
    y = 0.0
    for i in range(n):
        x = (x * 31 + i) % 65521
        y = y * 0.5 + x
    return x + int(y)


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


def objects(depth: int, many: int) -> int:
    """Short-lived objects."""
    nodes = 0
    for _ in range(many):
        tree = Tree(depth)
        nodes = nodes + tree.count()
    return nodes


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


def strings(n: int) -> int:
    """Create, search and read strings."""
    total = 0
    for i in range(n):
        text = "agent " + str(i) + " of " + str(n)
        total = total + len(text) + text.find("of") + int(text[6 : text.find(" of")])
    return total


def exceptions(n: int) -> int:
    """Exceptions of the program and of the machine, from a called function and from the same function."""
    few = [0] * 4
    total = 0
    for i in range(n):
        try:
            total = total + checked(i)
            if i % 5 == 0:
                total = total + few[i]
        except IndexError:
            total = total + 2
        except ValueError:
            total = total + 1
    return total


def checked(i: int) -> int:
    """Call `risky`; its exceptions pass through this function."""
    return risky(i) + 1


def risky(i: int) -> int:
    """Raise an exception in every third call."""
    if i % 3 == 0:
        raise ValueError("a third")
    return i


def dispatch(n: int) -> int:
    """One of five methods, by a number."""
    counter = Counter()
    seed = 7
    for i in range(n):
        seed = (seed * 1103 + 12345) % 65536
        what = seed % 5
        if what == 0:
            counter.add(seed)
        elif what == 1:
            counter.subtract(i)
        elif what == 2:
            counter.halve()
        elif what == 3:
            counter.swap()
        else:
            counter.turn()
    return counter.value + counter.turns


def queues(n: int) -> int:
    """Put numbers into a queue, and take them out in the same order."""
    queue = Queue()
    for i in range(50):
        queue.put(i)
    total = 0
    for i in range(n):
        number = queue.take()
        total = total + number
        queue.put((number * 7 + i) % 1000)
    return total


#: With the sizes of kernels.L, in its order.
KERNELS: dict[str, Callable[[], int]] = {
    "loop": lambda: loop(20000),
    "fib": lambda: fib(18),
    "sort": lambda: sort(250),
    "sieve": lambda: sieve(12000),
    "matrix": lambda: matrix(22),
    "strings": lambda: strings(1200),
    "objects": lambda: objects(7, 20),
    "exceptions": lambda: exceptions(4000),
    "dispatch": lambda: dispatch(8000),
    "queues": lambda: queues(6000),
}
