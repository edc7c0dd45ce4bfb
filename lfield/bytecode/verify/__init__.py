"""The verifier (DESIGN section 5): after it, no engine needs a check that it has made.

It runs on every program before anybody gets it, also on bytes from a peer. Records are checked before the
instructions that refer to them, so that later checks may follow an index without asking. Each check looks
at each record and each instruction once: the time is linear in the size of the program.
"""

from __future__ import annotations

from lfield.bytecode.program import Program
from lfield.bytecode.verify.code import check_code
from lfield.bytecode.verify.methods import check_debug, check_methods
from lfield.bytecode.verify.records import check_classes, check_constants, check_device_calls, check_types


def verify(program: Program) -> None:
    """Accept a sound program; raises ProgramFileError with the method and instruction that are not."""
    core = program.core
    check_types(core)
    check_classes(core)
    check_constants(core)
    check_device_calls(core)
    check_methods(core)
    check_debug(program)
    check_code(program)
