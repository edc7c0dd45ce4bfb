"""The shipped one-to-many rules, executed on resources that print their calls."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.testing.golden import run_text

#: Providers of the parts; all are on one host, so they are one robot.
MISSION = """
registry: 1
providers:
  Cart: {serves: {GoTo: {}, ReadPosition: {}}, attributes: {payload: 3.0, speed: 1.0}}
  Balloon: {serves: {Climb: {}}, attributes: {payload: 2.0}}
  Hand: {serves: {Grip: {}}, attributes: {payload: 1.0}}
  Eye: {serves: {LookAt: {}}}
  Camera: {serves: {Photograph: {}}}
  Nose: {serves: {Turn: {}, ReadPosition: {}}, attributes: {tools: [camera]}}
"""

RESOURCES = """
resource Cart {
    real[] at = new real[3];
    init(string[] arg) { at[0] = 9.0; }
    portal goTo(real north, real east, real down) {
        at[0] = north; at[1] = east; at[2] = down;
        print("goes to " + f2s(north) + " " + f2s(east) + " " + f2s(down));
    }
    portal position() emit real[] { return at; }
}
resource Balloon {
    init(string[] arg) { }
    portal climb(real height) emit real { print("up " + f2s(height)); return height * 0.9; }
    portal descend(real height) emit real { print("down " + f2s(height)); return height * 0.9; }
}
resource Hand {
    boolean empty;
    init(string[] arg) { empty = arg.length() > 1; }
    portal grip() emit boolean { print("grips"); return !empty; }
    portal release() { print("lets go"); }
}
resource Eye {
    init(string[] arg) { }
    portal lookAt(real north, real east, real down) { print("looks at " + f2s(north) + " " + f2s(east)); }
}
resource Camera {
    init(string[] arg) { }
    portal photograph() { print("click"); }
}
resource Nose {
    init(string[] arg) { }
    portal turnTo(real heading) { print("turns to " + f2s(heading, 2)); }
    portal position() emit real[] { real[] at = new real[3]; at[0] = 1.0; return at; }
}
"""


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """The shipped registry with the team of this file."""
    mission = Path(tmp_path_factory.mktemp("mission") / "mission.capabilities.yaml")
    mission.write_text(MISSION, encoding="utf-8")
    return read_registry(mission=mission)


def output_of(registry: Registry, agents: str, body: str) -> list[str]:
    """The output of a coordinator's statements with these agents: `Cart Hand?empty`."""
    team = []
    for agent in agents.split():
        name, mark, argument = agent.partition("?")
        team.append(f"// deploy: {name}:{name.lower()}{mark}{argument}")
    boss = f"coordinator Boss {{ init(string[] arg) {{ {body} }} }}"
    desk, _ = run_text("\n".join([*team, "// deploy: Boss:boss", RESOURCES, boss]), registry=registry)
    assert [agent.report for agent in desk.endings if agent.ended == "died"] == []
    return desk.output


def test_hand_and_balloon_lift(registry: Registry) -> None:
    body = """
        Lift[] who = findLift("payload == 1.0");
        print(f2s(who[0].lift(2.0), 2));
        print(f2s(who[0].lift(1.0), 2));
        print(f2s(who[0].lower(1.0), 2));
        who[0].lower(2.0);
    """
    lines = ["grips", "up 2.0", "1.80", "up 1.0", "0.90", "down 1.0", "0.90", "down 2.0", "lets go"]
    assert output_of(registry, "Hand Balloon", body) == lines


def test_lowering_by_the_lifted_height_releases_the_load(registry: Registry) -> None:
    body = "Lift who = findLift()[0]; real up = who.lift(2.0); who.lower(up);"
    assert output_of(registry, "Hand Balloon", body) == ["grips", "up 2.0", "down 1.8", "lets go"]


def test_lift_without_a_load_raises_an_exception(registry: Registry) -> None:
    body = "try { findLift()[0].lift(2.0); } catch (Exception e) { print(e.message()); }"
    assert output_of(registry, "Hand?empty Balloon", body) == ["grips", "no object to lift was gripped"]


def test_path_is_followed_point_by_point(registry: Registry) -> None:
    body = """
        real[] path = new real[6];
        path[0] = 1.0; path[4] = 2.0;
        FollowPath who = findFollowPath("speed == 1.0")[0];
        who.followPath(path);
        try { who.followPath(new real[4]); } catch (Exception e) { print(e.message()); }
    """
    lines = ["goes to 1.0 0.0 0.0", "goes to 0.0 2.0 0.0", "each point of a path needs north, east and down"]
    assert output_of(registry, "Cart", body) == lines


def test_load_is_hauled(registry: Registry) -> None:
    body = 'print(findHaul("payload == 1.0")[0].haul(1.0, 2.0, 0.0));'
    assert output_of(registry, "Cart Hand", body) == ["grips", "goes to 1.0 2.0 0.0", "lets go", "true"]
    assert output_of(registry, "Cart Hand?empty", body) == ["grips", "false"]


def test_object_is_retrieved(registry: Registry) -> None:
    body = "print(findRetrieve()[0].retrieve(1.0, 2.0, 0.0));"
    assert output_of(registry, "Cart Hand", body) == [
        "goes to 1.0 2.0 0.0",
        "grips",
        "goes to 9.0 0.0 0.0",
        "true",
    ]


def test_retrieving_requires_a_known_start_position(registry: Registry) -> None:
    assert output_of(registry, "Cart Hand Nose", "print(findRetrieve().length());") == ["1"]


def test_sentry_goes_to_its_post_and_looks(registry: Registry) -> None:
    body = """
        real[] post = new real[3]; real[] place = new real[3];
        post[0] = 5.0; place[1] = 7.0;
        print(findSentry()[0].watch(post, place, 2.5));
    """
    assert output_of(registry, "Cart Eye", body) == ["goes to 5.0 0.0 0.0", *["looks at 0.0 7.0"] * 3, "3"]


def test_scout_photographs_every_place(registry: Registry) -> None:
    body = "print(findScout()[0].scout(new real[6]));"
    place = ["goes to 0.0 0.0 0.0", "click"]
    assert output_of(registry, "Cart Camera", body) == [*place, *place, "2"]


def test_fixed_camera_looks_by_turning(registry: Registry) -> None:
    assert output_of(registry, "Nose", "findLookAt()[0].lookAt(1.0, 3.0, 0.0);") == ["turns to 1.57"]


def test_rules_build_on_rules(registry: Registry) -> None:
    body = "real[] at = new real[3]; findSentry()[0].watch(at, at, 1.0);"
    assert output_of(registry, "Cart Nose", body) == ["goes to 0.0 0.0 0.0", "turns to 3.14"]
