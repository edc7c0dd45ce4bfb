"""Random reals for tests of the maths, by seed; and the functions as WebAssembly over arrays."""

from __future__ import annotations

import ctypes
import math
import random
from array import array
from collections.abc import Callable
from inspect import signature

from lfield.vm.maths.intrinsics import MATHS
from lfield.vm.memory.word_codec import canonical, real_from_bits
from lfield.vm.wasm.lowering.maths_lowering import maths_name, maths_text

#: Edge cases.
EDGES = [
    *(0.0, 5e-324, 2.2250738585072009e-308, 2.2250738585072014e-308, 1e-160, 1e-17, 7.4505805969238281e-09),
    *(0.25, 0.5, 0.7071067811865476, 0.7853981633974483, 1.0, 1.4142135623730951, 1.5, 2.0, 2.5, 3.0, 10.0),
    *(0.9999999999999999, 1.0000000000000002, 709.782712893384, 709.8, 745.13, 745.2, 799999.9, 800000.0),
    *(4503599627370495.5, 4503599627370496.0, 9007199254740991.0, 9007199254740992.0, 9.3e18, 1e22, 1e300),
    *(6381956970095103 * 2.0**797, 1.7976931348623157e308, math.inf, math.nan, math.pi, math.pi / 2, math.e),
]
EDGES += [-x for x in EDGES]


def arity(name: str) -> int:
    """The number of arguments of an instruction's function."""
    return len(signature(MATHS[name]).parameters)


def any_real(rng: random.Random) -> float:
    """An edge case, random bits, a multiple of pi / 2, or a common number."""
    match rng.randrange(8):
        case 0:
            return rng.choice(EDGES)
        case 1 | 2:
            return canonical(real_from_bits(rng.getrandbits(64) - (1 << 63)))
        case 3:
            return rng.randrange(-(1 << rng.randrange(1, 53)), 1 << 53) * math.pi / 2
        case 4:
            return math.copysign(1.0 - rng.random() ** 12, rng.random() - 0.5)
        case 5:
            return rng.uniform(-2000.0, 2000.0)
        case 6:
            return float(rng.randrange(-40, 41)) / 2
        case _:
            return math.ldexp(rng.uniform(-1.0, 1.0), rng.randrange(-60, 60))


def arguments(name: str, count: int, seed: int) -> list[tuple[float, ...]]:
    """`count` tuples of random arguments for a function; in some, two reals are close to each other."""
    rng = random.Random(f"{name} {seed}")
    found = [tuple(any_real(rng) for _ in range(arity(name))) for _ in range(count)]
    if arity(name) == 1:
        return found
    if name == "pow":
        return [_bounded(x, y, rng) if rng.random() < 0.5 else (x, y) for x, y in found]
    return [(y, y * rng.uniform(-3.0, 3.0)) if rng.random() < 0.3 else (y, x) for y, x in found]


def _bounded(x: float, y: float, rng: random.Random) -> tuple[float, ...]:
    """Two reals whose power is finite."""
    size = abs(x)
    if not 0.0 < size < math.inf or size == 1.0:
        return x, y
    return size, rng.uniform(-745.0, 709.0) / math.log(size)


class Lowered:
    """Every function of the maths as WebAssembly, from one array of reals to another."""

    def __init__(self) -> None:
        # The functions in Python are tested without wasmtime too.
        import wasmtime

        loops = "\n".join(self._loop(name) for name in MATHS)
        engine = wasmtime.Engine()
        self._store = wasmtime.Store(engine)
        text = f'(module (memory (export "memory") 64)\n{maths_text(MATHS)}\n{loops})'
        instance = wasmtime.Instance(self._store, wasmtime.Module(engine, text), [])
        self._exports = instance.exports(self._store)

    def _loop(self, name: str) -> str:
        argument_count = arity(name)
        loads = " ".join(f"(f64.load offset={8 * k} (local.get 0))" for k in range(argument_count))
        return f"""(func (export "{name}") (param i32 i32)
          loop $again
            (f64.store (local.get 0) (call {maths_name(name)} {loads}))
            (local.set 0 (i32.add (local.get 0) (i32.const {8 * argument_count})))
            (br_if $again (i32.lt_u (local.get 0) (local.get 1)))
          end)"""

    def run(self, name: str, values: list[tuple[float, ...]]) -> list[float]:
        """The results for all arguments, at most half a million reals."""
        flat = array("d", [x for row in values for x in row])
        memory = self._exports["memory"]
        pointer = memory.data_ptr(self._store)
        ctypes.memmove(pointer, flat.tobytes(), 8 * len(flat))
        self._exports[name](self._store, 0, 8 * len(flat))
        results = array("d")
        results.frombytes(ctypes.string_at(pointer, 8 * len(flat)))
        return list(results)[:: arity(name)]


def differing(lowered: Lowered, name: str, values: list[tuple[float, ...]]) -> list[str]:
    """The indexes where WebAssembly and Python differ; all NaNs are equal."""
    function: Callable[..., float] = MATHS[name]
    lowered_value = lowered.run(name, values)
    found = []
    for row, their in zip(values, lowered_value, strict=True):
        reference_value = function(*row)
        if reference_value.hex() != their.hex():
            found.append(f"{name}{row}: {reference_value.hex()} and {their.hex()}")
    return found
