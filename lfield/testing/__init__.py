"""Public kits for tests: missions, golden programs, conformance kits."""

from lfield.testing.mission.answers import After, LObject, Throws

__all__ = ["After", "LObject", "Throws"]
