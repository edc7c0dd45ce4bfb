"""Golden files, and the drivers of the examples as installed drivers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from golden_files import GoldenFile

_EXAMPLES = Path(__file__).parents[2] / "examples" / "conftest.py"


def _fixtures_of_examples() -> tuple[object, object]:
    # All conftest.py files have the same module name, so this one cannot be imported.
    spec = spec_from_file_location("conftest_of_examples", _EXAMPLES)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.projects, module.projects_on_path


projects, projects_on_path = _fixtures_of_examples()


@pytest.fixture
def golden(pytestconfig: pytest.Config) -> Callable[[str], GoldenFile]:
    """`golden(name)`: the golden file of that name."""
    return partial(GoldenFile, rewrite=pytestconfig.option.rewrite)
