"""WebAssembly and Python give the same bits for the maths of L, for all arguments."""

from __future__ import annotations

import pytest
import refused_maths
from maths_values import EDGES, Lowered, arguments, arity, differing

from lfield.vm.maths.intrinsics import MATHS
from switching_engine import NEEDED

pytest.importorskip("wasmtime", reason=NEEDED)

from lfield.vm.wasm.lowering.maths_lowering import functions_text, maths_text


@pytest.fixture(scope="module")
def lowered() -> Lowered:
    return Lowered()


@pytest.mark.parametrize("name", MATHS)
def test_edge_cases_give_the_same_bits(name: str, lowered: Lowered) -> None:
    single = [(x,) for x in EDGES]
    pairs = [(y, x) for y in EDGES for x in EDGES]
    assert differing(lowered, name, single if arity(name) == 1 else pairs) == []


@pytest.mark.few(8)
@pytest.mark.parametrize("name", MATHS)
def test_random_arguments_give_the_same_bits(name: str, lowered: Lowered) -> None:
    """`tests/vm/maths/maths_many.py` compares millions."""
    assert differing(lowered, name, arguments(name, 4000, seed=1)) == []


def test_a_planted_fault_is_found(lowered: Lowered, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sine is lowered as the cosine."""
    monkeypatch.setitem(MATHS, "sin", MATHS["cos"])
    assert len(differing(lowered, "sin", arguments("sin", 100, seed=1))) > 50


def test_only_needed_functions_are_lowered() -> None:
    text = maths_text(["sqrt", "floor"])
    assert text.count("(func ") == 2
    assert maths_text(["asin"]).count("(func ") < maths_text(MATHS).count("(func ")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("power", "'x ** 2.0' in power cannot be lowered to WebAssembly"),
        ("mixed", "'x + 1' in mixed cannot be lowered to WebAssembly"),
        ("number_as_condition", "'x' in number_as_condition cannot be lowered to WebAssembly"),
        ("two_types", "y in two_types is of two types"),
        ("unknown", "'sorted((x, 1.0))[0]' in unknown cannot be lowered to WebAssembly"),
    ],
)
def test_python_beyond_the_subset_is_refused(name: str, said: str) -> None:
    with pytest.raises(TypeError) as refused:
        functions_text([getattr(refused_maths, name)])
    assert str(refused.value).startswith(said)
