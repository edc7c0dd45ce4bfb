"""What holds for all tests: a property is judged by what it finds, not by how busy the computer is."""

from __future__ import annotations

import os
import tempfile

from hypothesis import settings

settings.register_profile("any computer", settings(), deadline=None)
settings.load_profile("any computer")

#: What tests build is kept for this run only, and found in no other.
_CACHE = tempfile.TemporaryDirectory(prefix="lfield-tests-", ignore_cleanup_errors=True)
os.environ["XDG_CACHE_HOME"] = _CACHE.name
