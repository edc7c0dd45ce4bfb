"""What holds for all tests: a property is judged by what it finds, not by how busy the computer is."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("any computer", settings(), deadline=None)
settings.load_profile("any computer")
