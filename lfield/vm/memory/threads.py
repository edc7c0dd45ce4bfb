"""The threads of a block: a list on its heap, one record each, and where each of them is.

What is known of places is beside the block until its heap moves: nobody walks a list of a thousand.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterator

from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, Places
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
    if (places := block.places) is not None:
        places[identity] = place
        places.ids.append(identity)
    return identity


def threads(block: Block) -> Iterator[int]:
    """The places of all threads, youngest first."""
    place = block.w[layout.W_THREADS]
    while place:
        yield place
        place = block.w[place + THREAD_NEXT]


def count(block: Block) -> int:
    """How many threads there are."""
    return len(_places(block))


def place_of(block: Block, identity: int) -> int:
    """Where the thread with that id is; 0 when there is none."""
    places = block.places
    return (_places(block) if places is None else places).get(identity, 0)


def only_thread(block: Block) -> int:
    """The id of the thread of a coordinator, which has one."""
    w = block.w
    return w[w[layout.W_THREADS] + THREAD_ID]


def serving(block: Block, call: int) -> int:
    """The id of the thread that serves the portal call with that number; 0 when there is none."""
    w = block.w
    return next((w[place + THREAD_ID] for place in threads(block) if w[place + THREAD_CALL] == call), 0)


def unlink(block: Block, identity: int) -> None:
    """Take a thread out of the list. Whatever it has left on the heap is for the collector.

    But where it and its only frame still are what is on the top, as behind a portal that has kept nothing,
    they are given back at once: such calls cost no garbage.
    """
    w, places = block.w, _places(block)
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
        block.top = frame


def still_image(block: Block) -> bytes:
    """The block but for the states of its threads: equal when nothing that a program sees differs."""
    w = block.w
    words = [place + THREAD_STATE for place in _places(block).values()]
    states = [w[word] for word in words]
    for word in words:
        w[word] = 0
    image = bytes(block.image())
    for word, state in zip(words, states, strict=True):
        w[word] = state
    return image


def _places(block: Block) -> Places:
    """Where the threads are, looked up where the heap has moved."""
    places = block.places
    if places is None:
        w = block.w
        youngest_first = [(w[place + THREAD_ID], place) for place in threads(block)]
        places = block.places = Places(reversed(youngest_first))
    return places
