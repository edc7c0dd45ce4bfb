"""The meaning of rules: the most specific line decides; persons lose omitted rights except the stop."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, Identity, Right
from lfield.mission.access.access_rules import (
    NO_RULES,
    Access,
    CallerRule,
    CallPermissions,
    PersonRule,
    PortalRule,
    decode_access,
    encode_access,
)

ARM, ARM2, WINCH = (
    SimpleNamespace(id=id, type=type) for id, type in (("arm1", "Arm"), ("arm2", "Arm"), ("winch", "Winch"))
)
BOSS, ONE, LONE = (
    SimpleNamespace(id=id, type=type) for id, type in (("boss", "Boss"), ("one", "Relay"), ("lone", "Lone"))
)
FILE = "m.access.yaml"


def access(*callers: CallerRule) -> Access:
    return Access(FILE, (), callers)


def person(may: frozenset[Right], name: str = "anna") -> Identity:
    return Identity("person", name, may)


# --- portal calls -----------------------------------------------------------------------------------------


def test_a_caller_without_a_rule_may_call_everything() -> None:
    rules = access(CallerRule("agent", "boss", 2, ()))
    assert rules.refusal(ONE, ARM, "home") == NO_RULES.refusal(BOSS, ARM, "home") == ""


def test_caller_rules_by_name_override_type_and_others() -> None:
    rules = access(
        CallerRule("others", "others", 2, ()),
        CallerRule("type", "Relay", 3, (PortalRule("others", "others", 4, ("home",)),)),
        CallerRule("agent", "boss", 5),
    )
    assert rules.refusal(BOSS, ARM, "grab") == ""
    assert rules.refusal(ONE, ARM, "home") == ""
    assert rules.refusal(ONE, ARM, "grab") == (
        "one may not call arm1.grab(): m.access.yaml:4 allows home() of arm1 only"
    )
    assert rules.refusal(LONE, ARM, "home") == (
        "lone may not call arm1.home(): m.access.yaml:2 lists what other coordinators may call, without this "
        "portal"
    )


def test_resource_rules_by_name_override_type_capability_and_others() -> None:
    lines = (
        PortalRule("others", "others", 3, ()),
        PortalRule("capability", "Lift", 4, (), {"Winch": ("up", "down")}),
        PortalRule("type", "Arm", 5, ("home", "where")),
        PortalRule("agent", "arm2", 6, ()),
    )
    rules = access(CallerRule("agent", "boss", 2, lines))
    assert rules.refusal(BOSS, ARM, "where") == rules.refusal(BOSS, WINCH, "down") == ""
    assert rules.refusal(BOSS, ARM, "grab").endswith("m.access.yaml:5 allows home() and where() of arm1 only")
    assert rules.refusal(BOSS, ARM2, "where").endswith("m.access.yaml:6 allows no portal of arm2")
    assert rules.refusal(BOSS, WINCH, "stow").endswith("m.access.yaml:4 allows up() and down() of winch only")
    other = SimpleNamespace(id="lamp", type="Lamp")
    assert rules.refusal(BOSS, other, "on").endswith("m.access.yaml:3 allows no portal of lamp")


def test_capabilities_of_one_resource_add_up() -> None:
    lines = (
        PortalRule("capability", "Lift", 3, (), {"Winch": ("up", "down")}),
        PortalRule("capability", "Stow", 4, (), {"Winch": ("stow",)}),
    )
    rules = access(CallerRule("type", "Boss", 2, lines))
    assert [rules.refusal(BOSS, WINCH, portal) for portal in ("up", "down", "stow")] == ["", "", ""]
    assert rules.refusal(BOSS, WINCH, "spin").endswith("up(), down() and stow() of winch only")
    assert rules.refusal(BOSS, ARM, "home").endswith(
        "m.access.yaml:2 lists what a Boss may call, without this portal"
    )


def test_calls_are_checked_by_number_and_cached() -> None:
    rules = access(CallerRule("agent", "boss", 2, (PortalRule("type", "Arm", 3, ("home",)),)))
    calls = CallPermissions(rules, [ARM, WINCH, BOSS, ONE], ["home", "grab", "up"])
    for _ in range(2):
        assert calls("boss", "arm1", 0) == calls("one", "arm1", 1) == ""
        assert "arm1.grab()" in calls("boss", "arm1", 1)


NAMES = st.sampled_from(["boss", "one", "Boss", "Relay", "arm1", "arm2", "Arm", "Winch", "home", "up"])
PORTALS = st.none() | st.lists(NAMES, max_size=3).map(tuple)
LINES = st.builds(
    PortalRule,
    st.sampled_from(["agent", "type", "capability", "others"]),
    NAMES,
    st.integers(1, 99),
    PORTALS,
    st.dictionaries(NAMES, st.lists(NAMES, max_size=2).map(tuple), max_size=2),
)
CALLERS = st.builds(
    CallerRule,
    st.sampled_from(["agent", "type", "others"]),
    NAMES,
    st.integers(1, 99),
    st.none() | st.lists(LINES, max_size=4).map(tuple),
)


@given(
    st.lists(CALLERS, max_size=4), st.sampled_from([BOSS, ONE]), st.sampled_from([ARM, ARM2, WINCH]), NAMES
)
def test_any_rules_of_a_bundle_allow_a_call_or_refuse_it_with_the_rule(
    callers: list[CallerRule], coordinator: SimpleNamespace, resource: SimpleNamespace, portal: str
) -> None:
    rules = decode_access(encode_access(access(*callers)))
    reason = rules.refusal(coordinator, resource, portal)
    assert not reason or f"{FILE}:" in reason
    # One more line for this resource allows the call, with any other lines.
    let_in = CallerRule("agent", coordinator.id, 1, (PortalRule("agent", resource.id, 2, (portal,)),))
    assert access(let_in, *callers).refusal(coordinator, resource, portal) == ""


# --- persons ----------------------------------------------------------------------------------------------

PEOPLE = Access(
    FILE,
    (
        PersonRule("anna", (Right.OPERATE,), 2),
        PersonRule("bob", (), 3),
        PersonRule("others", (Right.OBSERVE,), 4),
    ),
)
RIGHTS = st.frozensets(st.sampled_from(Right))


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        # A person who may operate may stop and observe, as in a certificate.
        ("anna", ALL_RIGHTS),
        ("bob", {Right.STOP, Right.COMMAND}),
        ("carl", {Right.STOP, Right.COMMAND, Right.OBSERVE}),
    ],
)
def test_rules_restrict_all_rights(name: str, kept: set[Right]) -> None:
    assert PEOPLE.restrict(person(ALL_RIGHTS, name)).may == kept


@given(RIGHTS, st.sampled_from(["anna", "bob", "carl"]))
def test_a_mission_grants_no_right_and_removes_no_stop(may: frozenset[Right], name: str) -> None:
    left = PEOPLE.restrict(person(may, name))
    assert left.may <= may
    assert (Right.STOP in left.may) == (Right.STOP in may)
    for right in Right:
        assert bool(PEOPLE.why_not(person(may, name), right)) == (right in may - left.may)


def test_the_rule_that_removes_a_right_is_named() -> None:
    assert PEOPLE.why_not(person(ALL_RIGHTS, "bob"), Right.OPERATE) == (
        "bob may not operate in this mission: m.access.yaml:3 limits bob to: nothing"
    )
    assert PEOPLE.why_not(person(ALL_RIGHTS, "carl"), Right.OPERATE) == (
        "carl may not operate in this mission: m.access.yaml:4 limits others to: observe"
    )


def test_all_removed_rights_are_listed() -> None:
    denied = PEOPLE.denied_rights(person(ALL_RIGHTS, "carl"))
    assert denied == {Right.OPERATE: PEOPLE.why_not(person(ALL_RIGHTS, "carl"), Right.OPERATE)}
    assert (
        PEOPLE.denied_rights(person(frozenset({Right.STOP}), "bob"))
        == NO_RULES.denied_rights(person(ALL_RIGHTS))
        == {}
    )


def test_people_rules_apply_only_to_persons() -> None:
    for identity in (Identity("local", "bob", ALL_RIGHTS), Identity("host", "bob", ALL_RIGHTS), ANONYMOUS):
        assert PEOPLE.restrict(identity) is identity
    assert NO_RULES.restrict(person(ALL_RIGHTS)).may == ALL_RIGHTS


# --- calls of persons -------------------------------------------------------------------------------------


def test_portals_are_closed_to_persons_without_a_line() -> None:
    assert NO_RULES.person_refusal("anna", ARM, "home") != ""
    assert access(CallerRule("others", "others", 2)).person_refusal("anna", ARM, "home") != ""


def test_the_line_of_a_person_overrides_others() -> None:
    lines = (PortalRule("type", "Arm", 3, ("home",)), PortalRule("agent", "arm2", 4, ()))
    rules = Access(FILE, (), (), (CallerRule("person", "anna", 2, lines), CallerRule("others", "others", 5)))
    assert rules.person_refusal("anna", ARM, "home") == ""
    assert rules.person_refusal("anna", ARM, "grab") == (
        "anna may not call arm1.grab(): m.access.yaml:3 allows home() of arm1 only"
    )
    assert rules.person_refusal("anna", ARM2, "home").endswith("m.access.yaml:4 allows no portal of arm2")
    assert rules.person_refusal("anna", WINCH, "up").endswith(
        "m.access.yaml:2 lists what anna may call, without this portal"
    )
    for other in ("bob", ""):
        assert rules.person_refusal(other, ARM, "grab") == ""
    # Such a line does not apply to a coordinator.
    assert rules.refusal(SimpleNamespace(id="anna", type="Boss"), ARM, "grab") == ""
    assert decode_access(encode_access(rules)) == rules


@pytest.mark.parametrize(
    ("listed", "person", "may"),
    [((), "anna", False), (("anna",), "anna", True), (("anna",), "bob", False), (("anna",), "", False),
     (("others",), "bob", True), (("others",), "", True)],
)  # fmt: skip
def test_assistants_act_for_listed_persons_only(listed, person, may) -> None:
    assert (Access(FILE, assistants=listed).assistant_refusal(person) == "") is may
