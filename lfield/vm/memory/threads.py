"""The threads of a block: a list on its heap, one record each."""

from __future__ import annotations

from collections.abc import Iterator

from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import (
    FRAME,
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
)


def new_thread(block: Block, method: int, frame_words: int, entry: int, words: list[int], call: int) -> int:
    """A ready thread that will run a method on the words given (the object first); returns its id.

    Raises Full before the thread is in the list.
    """
    frame = block.allocate(FRAME, method, frame_words)
    place = block.allocate(THREAD, 0, THREAD_WORDS)
    w = block.w
    w[frame + FRAME_DEPTH] = 1
    for i, word in enumerate(words, frame + FRAME_SLOTS):
        w[i] = word
    identity = w[layout.W_NEXT_THREAD]
    w[layout.W_NEXT_THREAD] = identity + 1
    w[place + THREAD_ID] = identity
    w[place + THREAD_FRAME] = frame
    w[place + THREAD_PC] = entry
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
    """Take a thread out of the list; the collector takes the rest."""
    w = block.w
    before = layout.W_THREADS
    place = w[before]
    while place and w[place + THREAD_ID] != identity:
        before = place + THREAD_NEXT
        place = w[before]
    if place:
        w[before] = w[place + THREAD_NEXT]


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
