"""Instructions implemented by the maths of L, and the cases without a result (tables J.7, J.9).

An engine that lowers these functions may leave every non-finite result to the reference engine.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, isinf, isnan

from lfield.vm.maths import angles, powers, rounding, trigonometry

#: The function of one or two reals, by the name of its opcode.
MATHS: dict[str, Callable[..., float]] = {
    "modf": rounding.remainder,
    "abs_float": rounding.magnitude,
    "min_float": rounding.smaller,
    "max_float": rounding.larger,
    "sqrt": rounding.root,
    "sin": trigonometry.sin,
    "cos": trigonometry.cos,
    "tan": trigonometry.tan,
    "asin": angles.asin,
    "acos": angles.acos,
    "atan2": angles.atan2,
    "exp": powers.exp,
    "log": powers.log,
    "pow": powers.pow,
    "floor": rounding.floor,
    "ceil": rounding.ceil,
    "round": rounding.round,
}


def has_result(values: tuple[float, ...], result: float) -> bool:
    """Whether a result is valid: no NaN from other arguments, no infinity from finite arguments."""
    if isfinite(result):
        return True
    return any(isnan(v) for v in values) or (isinf(result) and any(isinf(v) for v in values))
