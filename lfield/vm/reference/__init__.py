"""Reference engine: a threaded-code interpreter in Python, the executable specification.

Every instruction is compiled to one closure, a step, which works on the registers and returns the number of
the next instruction. All state is in the block: registers are a copy of it during `run`.
"""

from lfield.vm.reference.reference_engine import ReferenceEngine

__all__ = ["ReferenceEngine"]
