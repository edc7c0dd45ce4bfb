"""Debug information: lines, names of slots, signatures, and the sources themselves."""

from __future__ import annotations

from pathlib import PurePath

from lfield.bytecode.program import Debug, MethodDebug, SourceText
from lfield.compiler.frame import Frame
from lfield.text.source import Source


def debug_information(sources: list[Source], frames: list[Frame]) -> Debug:
    """What a debugger, a traceback and a listing need to speak in the words of the source.

    Sources go by their base name: where they lay on somebody's disk is nobody's business on a robot.
    """
    number = {id(source): i for i, source in enumerate(sources)}
    return Debug(
        tuple(
            MethodDebug(
                number[id(frame.method.span.source)],
                tuple(frame.code.lines),
                tuple(frame.slots.names),
                frame.method.signature,
            )
            for frame in frames
        ),
        tuple(SourceText(PurePath(source.name).name, source.text) for source in sources),
    )
