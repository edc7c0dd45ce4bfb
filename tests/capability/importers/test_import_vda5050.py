"""Factsheets of VDA 5050 as providers."""

from __future__ import annotations

import json

import pytest

from lfield.errors import ProgramError

SHEET = {
    "headerId": 3,
    "version": "2.1.0",
    "manufacturer": "Somebody",
    "serialNumber": "12",
    "typeSpecification": {
        "seriesName": "Mule 600",
        "seriesDescription": "carries pallets",
        "agvKinematic": "DIFF",
        "agvClass": "CARRIER",
        "maxLoadMass": 600,
        "localizationTypes": ["NATURAL"],
        "navigationTypes": ["AUTONOMOUS"],
    },
    "physicalParameters": {
        "speedMin": 0.1,
        "speedMax": 1.8,
        "angularSpeedMax": 0.9,
        "accelerationMax": 0.6,
        "heightMax": 0.35,
        "width": 0.9,
        "length": 1.4,
    },
    "protocolLimits": {"maxStringLens": {"msgLen": 20000}},
    "protocolFeatures": {"agvActions": [{"actionType": "pick"}, {"actionType": "startCharging"}]},
    "agvGeometry": {"wheelDefinitions": []},
    "loadSpecification": {"loadSets": [{"setName": "pallet", "maxWeight": 550.5}, {"setName": "box"}]},
    "localizationParameters": {},
}


def sheet(**sections) -> str:
    return json.dumps(SHEET | sections)


def test_a_vehicle_is_a_provider_with_attributes(imports):
    provider = imports.registry(imports.run({"mule.json": sheet()})).providers["Mule600"]
    assert provider.meaning == "carries pallets"
    assert provider.attributes == {
        "payload": 600.0,
        "speed": 1.8,
        "turn_rate": 0.9,
        "chassis": "wheels",
        "environment": frozenset({"terrestrial"}),
    }
    assert provider.serves == {}


def test_what_has_no_attribute_is_said_with_its_value(imports):
    imported = imports.run({"mule.json": sheet()})
    said = [note.removeprefix(f"{imports.folder}/mule.json: ") for note in imported.notes]
    none = "no attribute of the registry says it"
    assert said == [
        "what Mule600 serves: write the resource in L and add its primitives, such as GoTo",
        f"typeSpecification.agvClass (CARRIER): {none}",
        f"typeSpecification.localizationTypes: {none}",
        f"typeSpecification.navigationTypes: {none}",
        f"physicalParameters.speedMin (0.1): {none}",
        f"physicalParameters.accelerationMax (0.6): {none}",
        f"physicalParameters.heightMax (0.35): {none}",
        f"physicalParameters.width (0.9): {none}",
        f"physicalParameters.length (1.4): {none}",
        "protocolLimits: limits of messages that L does not send",
        "action 'pick': a portal of your resource",
        "action 'startCharging': a portal of your resource",
        "agvGeometry: no attribute is a shape",
        "load set 'pallet': one payload stands for all",
        "load set 'box': one payload stands for all",
        "localizationParameters: the resource in L knows how it finds its place",
    ]


def test_the_names_of_version_3(imports):
    text = sheet(
        typeSpecification={
            "seriesName": "Mule 700",
            "mobileRobotKinematics": "THREE_WHEEL",
            "maximumLoadMass": 700.5,
        },
        physicalParameters={"maximumSpeed": 2.0, "maximumAngularSpeed": 1.0},
    )
    provider = imports.registry(imports.run({"mule.json": text})).providers["Mule700"]
    stated = {name: provider.attributes[name] for name in ("payload", "speed", "turn_rate", "chassis")}
    assert stated == {"payload": 700.5, "speed": 2.0, "turn_rate": 1.0, "chassis": "wheels"}


def test_the_heaviest_load_set_where_no_load_is_given_for_the_vehicle(imports):
    text = sheet(typeSpecification={"seriesName": "Mule", "maxLoadMass": 0})
    provider = imports.registry(imports.run({"mule.json": text})).providers["Mule"]
    assert provider.attributes["payload"] == 550.5


@pytest.mark.parametrize("speed", [None, "fast", True, -1, 0, 1e300, [], {}])
def test_what_is_no_amount_is_left_out(imports, speed):
    imported = imports.run({"mule.json": sheet(physicalParameters={"speedMax": speed})})
    assert "speed" not in imports.registry(imported).providers["Mule600"].attributes
    assert any("physicalParameters.speedMax" in note for note in imported.notes)


def test_vehicles_of_one_name_are_told_apart_by_their_makers(imports):
    imported = imports.run({"a.json": sheet(), "b.json": sheet(), "c.json": sheet()})
    registry = imports.registry(imported)
    assert {"Mule600", "SomebodyMule600", "SomebodyMule6002"} <= registry.providers.keys()


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("{", "C182", "Expecting property name"),
        ('{"typeSpecification": NaN}', "C182", "NaN is no number of JSON"),
        ('{"a": 1, "a": 2}', "C182", "'a' is there twice in one object"),
        ('{"a":' * 5000 + "1" + "}" * 5000, "C182", "nested too deep"),
        ('{"a": ' + "9" * 10_000 + "}", "C182", "Exceeds the limit"),
        (b'{"a": "\xff"}', "C182", "not UTF-8"),
        ('{"name": "no factsheet"}', "C181", "neither a spec of ROS capabilities nor a VDA 5050 factsheet"),
    ],
)
def test_hostile_json_is_refused(imports, text, code, words):
    with pytest.raises(ProgramError) as refused:
        imports.run({"bad.json": text})
    (diagnostic,) = refused.value.diagnostics
    assert diagnostic.code == code
    assert words in diagnostic.message
    diagnostic.render()


def test_a_byte_order_mark_is_none_of_the_factsheet(imports):
    imported = imports.run({"mule.json": b"\xef\xbb\xbf" + sheet().encode()})
    assert "Mule600" in imports.registry(imported).providers
