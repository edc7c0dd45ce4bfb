"""JSON schemas of the messages that Foxglove displays in its own panels: their names, fields and types. Pure.

The fields are those of https://docs.foxglove.dev/docs/visualization/message-schemas. Angles are radians,
lengths metres; a pose is in the frame of its entity.
"""

from __future__ import annotations

from typing import Any

from lfield.export.channels import JsonSchema, MessageSchema

_NUMBER: JsonSchema = {"type": "number"}
_INTEGER: JsonSchema = {"type": "integer"}
_TEXT: JsonSchema = {"type": "string"}
_FLAG: JsonSchema = {"type": "boolean"}
_BYTES: JsonSchema = {"type": "string", "contentEncoding": "base64"}


def _object(title: str = "", /, **fields: JsonSchema) -> dict[str, Any]:
    return {"type": "object", **({"title": title} if title else {}), "properties": fields}


def _array(items: JsonSchema) -> JsonSchema:
    return {"type": "array", "items": items}


def _numbers(names: str) -> JsonSchema:
    return _object(**dict.fromkeys(names, _NUMBER))


def _enumeration(*names: str) -> JsonSchema:
    """Numbers from 0 with their names."""
    return {"type": "integer", "oneOf": [{"title": name, "const": n} for n, name in enumerate(names)]}


def _time(title: str) -> JsonSchema:
    seconds = {"type": "integer"} if title == "duration" else {"type": "integer", "minimum": 0}
    return _object(title, sec=seconds, nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999})


_TIME, _DURATION = _time("time"), _time("duration")
_VECTOR, _ROTATION, _COLOR = _numbers("xyz"), _numbers("xyzw"), _numbers("rgba")
_POSE = _object(position=_VECTOR, orientation=_ROTATION)
_COLORS, _POINTS, _INDICES = _array(_COLOR), _array(_VECTOR), _array({"type": "integer", "minimum": 0})
_PAIRS = _array(_object(key=_TEXT, value=_TEXT))

_PRIMITIVES: dict[str, JsonSchema] = {
    "arrows": _object(
        pose=_POSE,
        shaft_length=_NUMBER,
        shaft_diameter=_NUMBER,
        head_length=_NUMBER,
        head_diameter=_NUMBER,
        color=_COLOR,
    ),
    "cubes": _object(pose=_POSE, size=_VECTOR, color=_COLOR),
    "spheres": _object(pose=_POSE, size=_VECTOR, color=_COLOR),
    "cylinders": _object(pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOR),
    "lines": _object(
        type=_enumeration("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
        pose=_POSE,
        thickness=_NUMBER,
        scale_invariant=_FLAG,
        points=_POINTS,
        color=_COLOR,
        colors=_COLORS,
        indices=_INDICES,
    ),
    "triangles": _object(pose=_POSE, points=_POINTS, color=_COLOR, colors=_COLORS, indices=_INDICES),
    "texts": _object(
        pose=_POSE, billboard=_FLAG, font_size=_NUMBER, scale_invariant=_FLAG, color=_COLOR, text=_TEXT
    ),
    "models": _object(
        pose=_POSE,
        scale=_VECTOR,
        color=_COLOR,
        override_color=_FLAG,
        url=_TEXT,
        media_type=_TEXT,
        data=_BYTES,
    ),
}

#: The kinds of shapes of an entity in a scene.
PRIMITIVES = tuple(_PRIMITIVES)


def _schema(kind: str, **fields: JsonSchema) -> MessageSchema:
    name = f"foxglove.{kind}"
    return MessageSchema(name, {"$comment": "fields as published by Foxglove", **_object(name, **fields)})


#: A position on the Earth: degrees, and metres above sea level.
LOCATION_FIX = _schema(
    "LocationFix",
    timestamp=_TIME,
    frame_id=_TEXT,
    latitude=_NUMBER,
    longitude=_NUMBER,
    altitude=_NUMBER,
    position_covariance={"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
    position_covariance_type=_enumeration("UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN"),
)

#: The poses of frames in other frames.
FRAME_TRANSFORMS = _schema(
    "FrameTransforms",
    transforms=_array(
        _object(
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_ROTATION,
        )
    ),
)

#: Changes of a scene: entities with an id replace earlier ones with that id.
SCENE_UPDATE = _schema(
    "SceneUpdate",
    deletions=_array(_object(timestamp=_TIME, type=_enumeration("MATCHING_ID", "ALL"), id=_TEXT)),
    entities=_array(
        _object(
            timestamp=_TIME,
            frame_id=_TEXT,
            id=_TEXT,
            lifetime=_DURATION,
            frame_locked=_FLAG,
            metadata=_PAIRS,
            **{name: _array(primitive) for name, primitive in _PRIMITIVES.items()},
        )
    ),
)

#: A log line.
LOG = _schema(
    "Log",
    timestamp=_TIME,
    level=_enumeration("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
    message=_TEXT,
    name=_TEXT,
    file=_TEXT,
    line={"type": "integer", "minimum": 0},
)
#: Levels of a log line.
INFO, WARNING, ERROR = 2, 3, 4
