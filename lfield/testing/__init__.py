"""Public test kits: missions, golden programs, conformance kits."""

from lfield.testing.mission.double_answers import After, Throws
from lfield.vm.person_calls.l_object import LObject

__all__ = ["After", "LObject", "Throws"]
