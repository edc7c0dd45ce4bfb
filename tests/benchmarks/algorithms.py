"""The algorithms of `engine`, each written in L and in Python the same way, statement by statement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Algorithm:
    """`source` has the classes and methods in L, `call` the L expression, `python` the same in Python.

    Both give the same int.
    """

    name: str
    classes: str
    methods: str
    call: str
    python: Callable[[], int]

    @property
    def source(self) -> str:
        """A coordinator that prints the result and the seconds it took."""
        return f"""{self.classes}
coordinator Bench {{
    init(string[] arg) {{
        real start = now();
        int result = {self.call};
        real end = now();
        print(result);
        print(end - start);
    }}
    {self.methods}
}}
"""


# --- recursive calls ----------------------------------------------------------------------------------

_FIB = """
    private int fib(int n) {
        if (n < 2) return n;
        return fib(n - 1) + fib(n - 2);
    }
"""


def fib(n: int) -> int:
    """Calls and int arithmetic."""
    if n < 2:
        return n
    return fib(n - 1) + fib(n - 2)


# --- loops over an array ------------------------------------------------------------------------------

_SIEVE = """
    private int sieve(int n) {
        boolean[] crossed = new boolean[n + 1];
        int primes = 0;
        int i = 2;
        while (i <= n) {
            if (!crossed[i]) {
                primes = primes + 1;
                int k = i + i;
                while (k <= n) {
                    crossed[k] = true;
                    k = k + i;
                }
            }
            i = i + 1;
        }
        return primes;
    }
"""


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


# --- real arithmetic ----------------------------------------------------------------------------------

_MATRIX = """
    private real[][] filled(int n) {
        real[][] m = new real[n][];
        for (int i = 0; i < n; i = i + 1) {
            m[i] = new real[n];
            for (int j = 0; j < n; j = j + 1) m[i][j] = i - j;
        }
        return m;
    }

    private int matrix(int n) {
        real[][] a = filled(n);
        real[][] b = filled(n);
        real trace = 0.0;
        for (int i = 0; i < n; i = i + 1) {
            for (int j = 0; j < n; j = j + 1) {
                real sum = 0.0;
                for (int k = 0; k < n; k = k + 1) sum = sum + a[i][k] * b[k][j];
                if (i == j) trace = trace + sum;
            }
        }
        return f2i(trace);
    }
"""


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


# --- many objects -------------------------------------------------------------------------------------

_TREE_CLASS = """
class Tree {
    public Tree left;
    public Tree right;
    public Tree(int depth) {
        if (depth > 0) {
            left = new Tree(depth - 1);
            right = new Tree(depth - 1);
        }
    }
    public int count() {
        if (left == null) return 1;
        return 1 + left.count() + right.count();
    }
}
"""
_TREES = """
    private int trees(int depth, int many) {
        int nodes = 0;
        for (int i = 0; i < many; i = i + 1) {
            Tree t = new Tree(depth);
            nodes = nodes + t.count();
        }
        return nodes;
    }
"""


class Tree:
    """A binary tree, as in L."""

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


def trees(depth: int, many: int) -> int:
    """Objects that are soon garbage."""
    nodes = 0
    for _ in range(many):
        tree = Tree(depth)
        nodes = nodes + tree.count()
    return nodes


ALGORITHMS = (
    Algorithm("fib(16)", "", _FIB, "fib(16)", lambda: fib(16)),
    Algorithm("sieve(8000)", "", _SIEVE, "sieve(8000)", lambda: sieve(8000)),
    Algorithm("matrix product (18 x 18)", "", _MATRIX, "matrix(18)", lambda: matrix(18)),
    Algorithm("binary trees (8 of depth 7)", _TREE_CLASS, _TREES, "trees(7, 8)", lambda: trees(7, 8)),
)
