"""Threads of a block: a list on its heap with one record each, and an index of their places.

The index is valid until the heap moves, and avoids walks over the list.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterator

from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import (
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    THREAD,
    THREAD_CALL,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_NEXT,
    THREAD_PC,
    THREAD_STATE,
    THREAD_WORDS,
    header,
)


def thread_template(method: int, frame_words: int, entry: int) -> memoryview[int]:
    """A template for `Block.new_thread`: a thread at an instruction of a method, preceded by its frame."""
    words = array("q", bytes(8 * (frame_words + THREAD_WORDS)))
    words[0] = header(FRAME, method, frame_words)
    words[FRAME_DEPTH] = 1
    words[frame_words] = header(THREAD, 0, THREAD_WORDS)
    words[frame_words + THREAD_PC] = entry
    return memoryview(words)


def threads(block: Block) -> Iterator[int]:
    """The places of all threads, youngest first."""
    place = block.w[layout.W_THREADS]
    while place:
        yield place
        place = block.w[place + THREAD_NEXT]


def count(block: Block) -> int:
    """The number of threads."""
    return len(block.index_threads())


def place_of(block: Block, identity: int) -> int:
    """The place of the thread with that id; 0 for none."""
    places = block.places
    return (block.index_threads() if places is None else places).get(identity, 0)


def only_thread(block: Block) -> int:
    """The id of the thread of a coordinator, which has exactly one."""
    w = block.w
    return w[w[layout.W_THREADS] + THREAD_ID]


def serving(block: Block, call: int) -> int:
    """The id of the thread that serves the portal call with that number; 0 for none."""
    w = block.w
    return next((w[place + THREAD_ID] for place in threads(block) if w[place + THREAD_CALL] == call), 0)


def unlink(block: Block, identity: int) -> None:
    """Remove a thread from the list. Its data is left to the collector.

    If the thread and its only frame are on the top of the heap, as after a portal without allocations, they
    are freed at once: such calls produce no garbage.
    """
    w, places = block.w, block.index_threads() if block.places is None else block.places
    place = places.pop(identity, 0)
    if not place:
        return
    ids = places.ids
    at = bisect_left(ids, identity)
    del ids[at]
    younger = places[ids[at]] + THREAD_NEXT if at < len(ids) else layout.W_THREADS
    w[younger] = w[place + THREAD_NEXT]
    if place + THREAD_WORDS != block.top:
        return
    frame = w[place + THREAD_FRAME]
    if frame + (w[frame] >> 32) == place and not w[frame + FRAME_CALLER]:
        block.set_top(frame)


def image_without_states(block: Block) -> bytes:
    """The block without the states of its threads: two of them are equal if a program cannot detect a
    difference.
    """
    w = block.w
    words = [place + THREAD_STATE for place in block.index_threads().values()]
    states = [w[word] for word in words]
    for word in words:
        w[word] = 0
    image = bytes(block.image())
    for word, state in zip(words, states, strict=True):
        w[word] = state
    return image
