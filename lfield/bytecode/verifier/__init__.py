"""The bytecode verifier: engines do not repeat its checks.

It checks every program before use, also untrusted bytes from a peer. Records are checked before the
instructions that refer to them, so that later checks may follow an index without a test. Each check visits
each record and each instruction once: the time is linear in the size of the program.
"""

from __future__ import annotations

from lfield.bytecode.program import Program
from lfield.bytecode.verifier.instructions import check_code
from lfield.bytecode.verifier.methods import check_debug, check_methods
from lfield.bytecode.verifier.record_checks import (
    check_classes,
    check_constants,
    check_device_calls,
    check_types,
)


def verify(program: Program) -> None:
    """Accept a valid program; raises ProgramFileError with the invalid method and instruction."""
    core = program.core
    check_types(core)
    check_classes(core)
    check_constants(core)
    check_device_calls(core)
    check_methods(core)
    check_debug(program)
    check_code(program)
