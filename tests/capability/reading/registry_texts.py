"""Registries as plain data: read from YAML, or drawn at random such that the reader accepts them."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from lfield.text.source_text import Diagnostics, Source
from lfield.text.yaml_source import YamlList, YamlMapping, YamlNode, parse


def plain(text: str) -> object:
    """The document of a text as Python's own mappings and lists, by the rules of lfield's YAML."""
    found = Diagnostics()
    node = parse(Source("plain.yaml", text), found)
    assert found.errors == []
    assert node is not None
    return _plain(node)


def _plain(node: YamlNode) -> object:
    if isinstance(node, YamlMapping):
        return {key: _plain(entry.value) for key, entry in node.entries.items()}
    if isinstance(node, YamlList):
        return [_plain(item) for item in node.items]
    return node.value


#: Names that are no keywords of L, not reserved, and not in the base.
_SMALL = st.sampled_from(["amber", "birch", "cedarWood", "delta_9", "ebony", "fir", "gorse"])
_LARGE = st.sampled_from(["Amber", "Birch", "CedarWood", "Delta9", "Ebony"])
_RULES = st.sampled_from(["amber", "birch-bends", "cedar-9", "delta-and-ebony"])
_SENTENCES = st.sampled_from(["", "what it is", "a: colon", "'quoted'"])
_TYPES = st.sampled_from(["boolean", "int", "real", "string", "real[]", "int[]", "string[]"])
_CONDITIONS = st.sampled_from(
    ["payload >= 2.0", "environment == aerial && !legal", "limbs + 1 < 4 || chassis == hull", "true", True]
)
_VALUES: dict[str, st.SearchStrategy[Any]] = {
    "payload": st.one_of(st.floats(0, 1e6), st.integers(0, 99), st.sampled_from(["300 g", "0.2 t"])),
    "limbs": st.integers(-5, 5),
    "legal": st.booleans(),
    "chassis": st.sampled_from(["hull", "wheels"]),
    "environment": st.sampled_from(["aerial", [], ["aquatic"], ["aerial", "aquatic"]]),
    "heat": st.sampled_from([20, "300 K", "70 degF"]),
}


def _some(**optional: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """A mapping in which any key may be absent."""
    return st.fixed_dictionaries({}, optional=optional)


def _attributes() -> st.SearchStrategy[dict[str, Any]]:
    numbers = st.fixed_dictionaries(
        {"type": st.sampled_from(["real", "int"])},
        optional={
            "unit": st.sampled_from(["", "m", "kg", "m/s", "N m", "°C", "deg"]),
            "better": st.sampled_from(["more", "less", "none"]),
            "typical": st.floats(1e-6, 1e6),
            "live": st.booleans(),
            "max_age": st.floats(0.1, 1000.0),
            "meaning": _SENTENCES,
        },
    )
    words = st.fixed_dictionaries(
        {"type": st.sampled_from(["text", "set"])},
        optional={"values": st.one_of(st.none(), st.lists(st.sampled_from(["a", "b b", "c"]), unique=True))},
    )
    return st.dictionaries(_SMALL, st.one_of(numbers, words), max_size=3)


def _primitives() -> st.SearchStrategy[dict[str, Any]]:
    parameter = st.fixed_dictionaries({"type": _TYPES}, optional={"meaning": _SENTENCES})
    portal = st.one_of(
        st.none(),
        _some(
            parameters=st.one_of(st.none(), st.dictionaries(_SMALL, parameter, max_size=3)),
            emit=st.one_of(st.just("void"), _TYPES),
            effect=st.sampled_from(["query", "idempotent", "actuate"]),
            raises=st.lists(st.just("DeviceException"), max_size=1),
            meaning=_SENTENCES,
        ),
    )
    primitive = st.fixed_dictionaries(
        {
            "id": st.sampled_from(["skill", "skill.raising", "skill.gripping"]),
            "portals": st.dictionaries(_SMALL, portal, min_size=1, max_size=3),
        },
        optional={"meaning": _SENTENCES},
    )
    return st.dictionaries(_LARGE, primitive, max_size=2)


def _providers() -> st.SearchStrategy[dict[str, Any]]:
    argument = st.one_of(
        st.just("height"),
        st.integers(-9, 9),
        st.booleans(),
        st.sampled_from(
            [{"parameter": "height", "unit": "mm"}, {"parameter": "height"}, {"constant": "text"}]
        ),
    )
    emit = st.sampled_from([{"unit": "mm"}, {"parameter": "height"}, {"constant": 2.5}])
    mapped = st.one_of(
        _SMALL, st.none(), _some(portal=_SMALL, arguments=st.lists(argument, max_size=3), emit=emit)
    )
    values = _some(**_VALUES)
    lift = _some(when=_CONDITIONS, attributes=values, portals=_some(lift=mapped))
    live = _some(
        battery=st.sampled_from(["fc.battery", {"from": "fc.battery", "unit": "%"}]),
        north=st.just("fc.position[0]"),
    )
    provider = _some(
        include=st.just("can/winch.L"),
        attributes=st.one_of(st.none(), values),
        live=live,
        serves=_some(Lift=st.one_of(st.none(), lift), Grip=st.just({})),
        meaning=_SENTENCES,
    )
    return st.dictionaries(
        st.sampled_from(["Crane", "Ox", "Hoist2"]), st.one_of(st.none(), provider), max_size=3
    )


def _rules() -> st.SearchStrategy[dict[str, Any]]:
    rule = st.fixed_dictionaries(
        {
            "serves": st.just("Lift"),
            "by": st.just("Climb"),
            "portals": st.just({"lift": {"portal": "climb", "emit": {"parameter": "height"}}}),
        },
        optional={"when": _CONDITIONS, "loss": st.floats(0, 1), "meaning": _SENTENCES},
    )
    return st.dictionaries(_RULES, rule, max_size=3)


def registries() -> st.SearchStrategy[dict[str, Any]]:
    """A file that the reader accepts together with the base of the golden files."""
    terms = st.dictionaries(
        st.sampled_from(["skill.sewing", "skill.sailing", "perception"]),
        st.one_of(st.none(), _some(name=_SENTENCES, meaning=_SENTENCES, deprecated=st.just("skill.lifting"))),
        max_size=3,
    )
    agents = st.text("abé-9 #:", min_size=1, max_size=5)
    weight = st.floats(0, 1e6)
    ranking = _some(
        weights=_some(fitness=weight, loss=weight, part=weight, hop=weight, age=weight),
        attributes=_some(payload=weight, limbs=weight),
    )
    return st.fixed_dictionaries(
        {"registry": st.just(1)},
        optional={
            "taxonomy": st.one_of(st.none(), terms),
            "attributes": st.one_of(st.none(), _attributes()),
            "primitives": st.one_of(st.none(), _primitives()),
            "providers": st.one_of(st.none(), _providers()),
            "equivalences": st.one_of(st.none(), _rules()),
            "agents": st.dictionaries(agents, _some(**_VALUES), max_size=2),
            "ranking": st.one_of(st.none(), ranking),
        },
    )
