"""The reference engine: plain Python over the words of a block, the executable specification.

Every instruction becomes one small closure, a step; a step does its work on the registers and returns the
number of the next instruction. All state is in the block: the registers only mirror it during `run`.
"""

from lfield.vm.reference.run import Engine

__all__ = ["Engine"]
