"""The L classes of the one-to-many rules compile in a program that uses them, on the stock resource types."""

from __future__ import annotations

import pytest
from shipped_registry import DEVICES, REGISTRY, find_include

from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.lang.frontend import check_text

INCLUDES = "\n".join(f"include <{p.include}>;" for p in REGISTRY.providers.values())


def findings(program: str) -> list[str]:
    """Findings of the front end for a program with all stock resource types."""
    types = RegistryTypes(lambda: REGISTRY)
    text = f"{INCLUDES}\n{program}"
    checked = check_text(text, devices=DEVICES, find_include=find_include, capabilities=types)
    return [d.render() for d in checked.diagnostics]


def test_every_primitive_can_be_queried() -> None:
    queries = "\n".join(
        f"{name}[] who{number} = find{name}();" for number, name in enumerate(sorted(REGISTRY.primitives))
    )
    assert findings(f"coordinator C {{ init(string[] arg) {{ {queries} }} }}") == []


@pytest.mark.parametrize("name", sorted(REGISTRY.compositions))
def test_one_to_many_rule_has_its_class(name: str) -> None:
    rule = REGISTRY.compositions[name]
    assert rule.source.is_file()
    assert findings(f"coordinator C {{ init(string[] arg) {{ {rule.through} whole = null; }} }}") != []
    assert (
        findings(
            f"coordinator C {{ init(string[] arg) {{ {rule.serves} who = null; {rule.through} w = null; }} }}"
        )
        == []
    )


def test_coordinator_calls_every_composed_portal() -> None:
    program = """
    coordinator C {
        init(string[] arg) {
            real[] path = new real[6];
            real up = findLift("payload >= 0.1")[0].lift(1.0);
            up = findLift()[0].lower(up);
            findLookAt()[0].lookAt(1.0, 2.0, 0.0);
            findFollowPath()[0].followPath(path);
            boolean got = findHaul()[0].haul(1.0, 2.0, 0.0) && findRetrieve()[0].retrieve(1.0, 2.0, 0.0);
            int n = findSentry()[0].watch(path, path, 3.0) + findScout()[0].scout(path);
        }
    }
    """
    assert findings(program) == []
