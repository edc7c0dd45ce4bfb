"""Specs of ROS capabilities as a registry: what carries over, and what is said of the rest."""

from __future__ import annotations

import pytest

from lfield.capability.reading.subsumption import subsumptions
from lfield.errors import ProgramError

GRIPPER = """\
%YAML 1.1
---
name: ToolChanger
spec_version: 1
spec_type: interface
description: 'Takes a tool, and puts it back.'
interface:
  topics:
    provides:
      'tool/state': {type: std_msgs/String}
    requires:
      'tool/wish': {type: std_msgs/String}
  services:
    provides:
      'tool/take_up': {type: std_srvs/Trigger, description: 'takes the tool in front of it'}
      'tool/put_back': {type: std_srvs/srv/Empty}
      'tool/set_light': {type: std_srvs/SetBool}
      'tool/choose': {type: shop_msgs/Choose}
    requires:
      'door/open': {type: std_srvs/Empty}
  actions:
    'tool/swap': {type: shop_msgs/SwapAction}
  parameters:
    requires: {shelf: {type: string}}
  dynamic_parameters: [force]
"""
QUICK = """\
name: QuickToolChanger
spec_version: 1
spec_type: semantic_interface
redefines: shop/ToolChanger
description: changes without stopping
global_namespace: quick
"""
PROVIDER = """\
name: pneumatic_changer
spec_version: 1
spec_type: provider
implements: shop/QuickToolChanger
description: "with 6 bar: a \\"fast\\" one"
launch_file: launch/changer.launch
depends_on: {'shop/Air': {provider: 'shop/compressor'}}
remappings: {topics: {'tool/state': 'state'}}
"""
ALL = {
    "shop/providers/changer.yaml": PROVIDER,
    "shop/semantic_interfaces/quick.yaml": QUICK,
    "shop/interfaces/changer.yaml": GRIPPER,
}


def notes(imported) -> list[str]:
    """Without the folders they are about."""
    return [note.rpartition("yaml: ")[2] for note in imported.notes]


def test_an_interface_is_a_term_and_a_primitive(imports):
    registry = imports.registry(imports.run({"shop/interfaces/changer.yaml": GRIPPER}))
    term = registry.terms["skill.tool_changer"]
    assert (term.name, term.meaning) == ("ToolChanger", "Takes a tool, and puts it back.")
    portals = registry.primitives["ToolChanger"].portals
    shapes = {p.name: ([(x.name, x.type) for x in p.parameters], p.result) for p in portals.values()}
    assert shapes == {
        "takeUp": ([], "boolean"),
        "putBack": ([], "void"),
        "setLight": ([("data", "boolean")], "boolean"),
    }
    assert portals["takeUp"].meaning == "takes the tool in front of it"
    assert registry.primitives["ToolChanger"].id == "skill.tool_changer"


def test_what_an_interface_cannot_bring_along_is_said(imports):
    imported = imports.run({"changer.yaml": GRIPPER})
    answer = "the text of its answer; the portal emits whether it worked"
    assert notes(imported) == [
        "topic 'tool/state' (std_msgs/String): a portal is called, it is no stream of messages",
        "topic 'tool/wish' (std_msgs/String): a portal is called, it is no stream of messages",
        f"service 'tool/take_up' (std_srvs/Trigger): {answer}",
        f"service 'tool/set_light' (std_srvs/SetBool): {answer}",
        "service 'tool/choose' (shop_msgs/Choose): the spec does not say what it takes and gives",
        "service 'door/open' (std_srvs/Empty): the robot would call it, and a portal is called on the robot",
        "action 'tool/swap' (shop_msgs/SwapAction): the spec does not say what it takes and gives",
        "parameter 'shelf' (string): the constructor's arguments in the deployment take its place",
        "dynamic parameter 'force': what can be set while it runs is a portal of its own",
    ]
    assert all(f"#   {note}" in imported.text for note in imported.notes)


def test_whoever_serves_a_semantic_interface_serves_the_general_one(imports):
    registry = imports.registry(imports.run(ALL))
    assert registry.primitives["QuickToolChanger"].id == "skill.tool_changer.quick_tool_changer"
    assert "QuickToolChanger-is-ToolChanger" in registry.equivalences
    assert "QuickToolChanger-is-ToolChanger" in subsumptions(registry.primitives)


def test_a_provider_serves_what_it_implements_in_whatever_order_the_files_come(imports):
    imported = imports.run(ALL)
    provider = imports.registry(imported).providers["PneumaticChanger"]
    assert list(provider.serves) == ["QuickToolChanger"]
    assert provider.meaning == 'with 6 bar: a "fast" one'
    assert [note for note in imported.notes if "providers/changer.yaml" in note] == [
        f"{imports.folder}/shop/providers/changer.yaml: {text}"
        for text in (
            "launch_file: the deployment says what runs where",
            "depends_on: a class in L calls what it needs; see 'needs' in a one-to-many rule",
            "remappings: names of ROS have no meaning in L",
            "how it works: write the resource PneumaticChanger "
            "with the portals takeUp, putBack, setLight in L",
        )
    ]


def test_what_refers_to_something_that_is_not_there(imports):
    imported = imports.run({"a.yaml": QUICK, "b.yaml": PROVIDER})
    assert "it redefines shop/ToolChanger, which is in none of the files" in notes(imported)
    missing = "the provider: it implements shop/QuickToolChanger, which is in none of the files"
    assert missing in notes(imported)
    registry = imports.registry(imported)
    assert "PneumaticChanger" not in registry.providers


def test_an_interface_of_topics_is_only_a_term(imports):
    text = "name: Scan\nspec_version: 1\ninterface: {topics: {provides: {scan: {type: a/B}}}}\n"
    provider = "name: laser\nspec_version: 1\nimplements: Scan\n"
    imported = imports.run({"scan.yaml": text, "laser.yaml": provider})
    registry = imports.registry(imported)
    assert registry.terms["skill.scan"].name == "Scan"
    assert "Scan" not in registry.primitives
    assert "nothing of Scan can be called: it is a term, and no primitive" in notes(imported)
    assert "the provider: it implements Scan, of which nothing can be called" in notes(imported)


def test_names_that_are_taken_get_a_qualifier(imports):
    one = GRIPPER.replace("ToolChanger", "Lift")
    imported = imports.run({"a/interfaces/x.yaml": one, "b/interfaces/x.yaml": one, "c.yaml": one})
    registry = imports.registry(imported)
    assert {"ALift", "BLift", "Lift2"} <= registry.primitives.keys()
    assert {"skill.lift", "skill.b_lift", "skill.lift_2"} <= registry.terms.keys()


def test_full_names_tell_packages_apart(imports):
    scan = "name: Scan\nspec_version: 1\ninterface: {services: {NAME: {type: std_srvs/Empty}}}\n"
    files = {f"{p}/interfaces/scan.yaml": scan.replace("NAME", f"look_{p}") for p in ("left", "right")}
    provider = "name: laser\nspec_version: 1\nimplements: right/Scan\n"
    registry = imports.registry(imports.run({**files, "laser.yaml": provider}))
    (served,) = registry.providers["Laser"].serves
    assert list(registry.primitives[served].portals) == ["lookRight"]


@pytest.mark.parametrize("name", ["class", "while", "score", "agent", "9 lives", "ÄÖ", "::", "set__X"])
def test_odd_names_become_names_of_l(imports, name):
    text = (
        f'name: "{name}"\nspec_version: 1\ninterface: {{services: {{"{name}": {{type: std_srvs/Empty}}}}}}\n'
    )
    imports.registry(imports.run({"odd.yaml": text}))


@pytest.mark.parametrize("version", ["2", "0", "true", "'1'", "[]"])
def test_another_version_is_refused(imports, version):
    with pytest.raises(ProgramError) as refused:
        imports.run({"new.yaml": f"name: X\nspec_version: {version}\ninterface: {{}}\n"})
    assert [d.code for d in refused.value.diagnostics] == ["C180"]


def test_mistakes_of_all_files_are_reported_together(imports):
    files = {
        "a.yaml": "registry: 1\n",
        "b.yaml": "x: [",
        "c.yaml": "name: X\nspec_version: 7\nredefines: Y\n",
    }
    with pytest.raises(ProgramError) as refused:
        imports.run(files)
    assert [d.code for d in refused.value.diagnostics] == ["C181", "Y101", "C180"]
