"""The stored inputs of each decoder: one file, a msgpack list of bytes, the shortest first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from msgspec import msgpack

CORPUS = Path(__file__).parent / "corpus"


def corpus_of(name: str) -> list[bytes]:
    """The stored inputs of a target."""
    path = CORPUS / f"{name}.msgpack"
    return list(msgpack.decode(path.read_bytes(), type=list[bytes])) if path.is_file() else []


def keep(name: str, inputs: list[bytes]) -> None:
    """Store the inputs of a target: the same inputs always give the same file."""
    CORPUS.mkdir(exist_ok=True)
    ordered = sorted(set(inputs), key=lambda data: (len(data), data))
    (CORPUS / f"{name}.msgpack").write_bytes(msgpack.encode(ordered))


def fixed(name: str, make: Callable[[], list[bytes]]) -> list[bytes]:
    """Valid inputs that cannot be reproduced, such as keys and databases: made once, and stored."""
    path = CORPUS / f"{name}.seeds.msgpack"
    if not path.is_file():
        path.write_bytes(msgpack.encode(make()))
    return list(msgpack.decode(path.read_bytes(), type=list[bytes]))
