"""The realisations of a primitive, and the field of each in its class in L.

The class that the compiler makes for a primitive (class_generator.py) has one field for every realisation; in
an offer only the fields of its own realisation are filled. The compiler and the machine use the names of this
module.
"""

from __future__ import annotations

import re


def direct(resource: str) -> str:
    """The field of a resource of that type: a proxy."""
    return f"by{resource}"


def equivalent(rule: str) -> str:
    """The field of a substitution by a one-to-one rule: an offer of another primitive."""
    return f"as_{identifier(rule)}"


def composed(rule: str) -> str:
    """The field of the object that combines the parts: null until the first call makes it."""
    return f"of_{identifier(rule)}"


def part(rule: str, need: str) -> str:
    """The field of one part of a composition: an offer of the primitive that is needed."""
    return f"of_{identifier(rule)}_{identifier(need)}"


def identifier(name: str) -> str:
    """A name of the registry as part of a name in L: `grip-and-climb` is `grip_and_climb`."""
    return re.sub(r"[^A-Za-z0-9]", "_", name)
