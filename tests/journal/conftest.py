"""A journal on a real disk, in a folder of the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from journal_bench import FileBench


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[FileBench]:
    file_bench = FileBench(tmp_path)
    yield file_bench
    file_bench.end()
