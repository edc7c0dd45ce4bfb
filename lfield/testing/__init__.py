"""Public test kits: missions, golden programs, conformance kits."""

from lfield.testing.mission.double_answers import After, LObject, Throws

__all__ = ["After", "LObject", "Throws"]
