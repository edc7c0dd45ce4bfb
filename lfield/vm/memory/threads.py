"""The threads of a block: a list on its heap, one record each."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import (
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_SLOTS,
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
    """A thread that will run a method from an instruction on, and its frame before it, for `new_thread`."""
    words = array("q", bytes(8 * (frame_words + THREAD_WORDS)))
    words[0] = header(FRAME, method, frame_words)
    words[FRAME_DEPTH] = 1
    words[frame_words] = header(THREAD, 0, THREAD_WORDS)
    words[frame_words + THREAD_PC] = entry
    return memoryview(words)


def new_thread(block: Block, template: memoryview[int], words: list[int], call: int) -> int:
    """A ready thread made by a template, to run on the words given (the object first); returns its id.

    Raises Full before anything is written.
    """
    frame = block.stamp(template)
    w = block.w
    place = frame + (w[frame] >> 32)
    slot = frame + FRAME_SLOTS
    for word in words:
        w[slot] = word
        slot += 1
    identity: int = w[layout.W_NEXT_THREAD]
    w[layout.W_NEXT_THREAD] = identity + 1
    w[place + THREAD_ID] = identity
    w[place + THREAD_FRAME] = frame
    w[place + THREAD_CALL] = call
    w[place + THREAD_NEXT] = w[layout.W_THREADS]
    w[layout.W_THREADS] = place
    return identity


def threads(block: Block) -> Iterator[int]:
    """The places of all threads, youngest first."""
    place = block.w[layout.W_THREADS]
    while place:
        yield place
        place = block.w[place + THREAD_NEXT]


def count(block: Block) -> int:
    """How many threads there are."""
    w = block.w
    found = 0
    place = w[layout.W_THREADS]
    while place:
        found += 1
        place = w[place + THREAD_NEXT]
    return found


def place_of(block: Block, identity: int) -> int:
    """Where the thread with that id is; 0 when there is none."""
    w = block.w
    place = w[layout.W_THREADS]
    while place and w[place + THREAD_ID] != identity:
        place = w[place + THREAD_NEXT]
    return place


def serving(block: Block, call: int) -> int:
    """The id of the thread that serves the portal call with that number; 0 when there is none."""
    w = block.w
    return next((w[place + THREAD_ID] for place in threads(block) if w[place + THREAD_CALL] == call), 0)


def unlink(block: Block, identity: int) -> None:
    """Take a thread out of the list. Whatever it has left on the heap is for the collector.

    But where it and its only frame still are what is on the top, as behind a portal that has kept nothing,
    they are given back at once: such calls cost no garbage.
    """
    w = block.w
    before = layout.W_THREADS
    place = w[before]
    while place and w[place + THREAD_ID] != identity:
        before = place + THREAD_NEXT
        place = w[before]
    if not place:
        return
    w[before] = w[place + THREAD_NEXT]
    if place + THREAD_WORDS != block.top:
        return
    frame = w[place + THREAD_FRAME]
    if frame + (w[frame] >> 32) == place and not w[frame + FRAME_CALLER]:
        block.top = frame


def still_image(block: Block) -> bytes:
    """The block but for the states of its threads: equal when nothing that a program sees differs."""
    w = block.w
    states = [(place + THREAD_STATE, w[place + THREAD_STATE]) for place in threads(block)]
    for word, _ in states:
        w[word] = 0
    image = bytes(block.image())
    for word, state in states:
        w[word] = state
    return image
