"""The shipped taxonomy has every primitive of the thesis, under the same parent."""

from __future__ import annotations

import re

import pytest
from shipped_registry import REGISTRY

#: Chapter IV, Example Robotic Capability Primitives: the lists below the five perspectives.
THESIS = """
Descriptive
    Environment
        Aerial
        Aquatic
        Arboreal
        Fossorial
        Terrestrial
    Structural
        Chassis
        Limbs
        Tools
    Operating
        Emissions
        Power Consumption
        Power Source
Maneuverability
    Directional Force
        Longitudinal
        Vertical
        Lateral
    Rotational Force
        Yaw
        Pitch
        Roll
    Dynamical Systems Theory
        Kinetics
        Kinematics
        Linear Maneuverability Number
        Propulsor Effectiveness Number
Perception
    Extended Touch
        Bump
        Texture
        Torque
        Pressure
        Temperature
    Extended Hearing
    Extended Taste/Smell
        pH
        Oxygen
        Carbon Monoxide
    Extended Vision
        Radio
        Microwaves
        Infrared
        Visible Light
        Ultraviolet
        X-Rays
        Gamma Rays
    Electrical
    Magnetic
    Spatial
        Position
        Displacement
        Velocity
        Acceleration
Skill
    Reactive Navigation
        Path Following
        Exploration
        Docking
    Fabrication
        Welding
        Grinding
        Painting
        Drilling
        Cutting
    Material Handling
        Hauling
        Retrieval
        Stacking
    Assembly
    Security
        Sentry
        Reconnaissance
    Communication
        OSI Model
Off-line Reasoning
    Path Planning
        Topological
        Metric
    Mapping
        Topological
        Metric
    Map Registration
    Encryption/Decryption
"""


def paths_of_thesis() -> list[tuple[str, ...]]:
    """Every name of the list with the names above it."""
    above: list[str] = []
    paths = []
    for line in THESIS.strip().splitlines():
        depth = (len(line) - len(line.lstrip())) // 4
        above[depth:] = [line.strip()]
        paths.append(tuple(above))
    return paths


def id_of(path: tuple[str, ...]) -> str:
    """The id of a path of names: `Taste/Smell` is `taste_smell`."""
    return ".".join(re.sub(r"[^a-z]+", "_", name.lower()) for name in path)


def test_list_of_the_thesis_is_complete() -> None:
    paths = paths_of_thesis()
    assert len(paths) == 86
    assert [path[0] for path in paths if len(path) == 1] == [
        "Descriptive",
        "Maneuverability",
        "Perception",
        "Skill",
        "Off-line Reasoning",
    ]


@pytest.mark.parametrize("path", paths_of_thesis(), ids="/".join)
def test_primitive_of_the_thesis_is_in_the_taxonomy(path: tuple[str, ...]) -> None:
    term = REGISTRY.terms[id_of(path)]
    assert term.name == path[-1]
    assert not term.deprecated


def test_every_term_has_a_name_and_one_sentence() -> None:
    for term in REGISTRY.terms.values():
        assert term.name, term.id
        assert term.meaning, term.id
        assert ". " not in term.meaning, term.id


def test_every_term_has_its_perspective() -> None:
    perspectives = {id_of(path) for path in paths_of_thesis() if len(path) == 1}
    assert {id.partition(".")[0] for id in REGISTRY.terms} == perspectives
