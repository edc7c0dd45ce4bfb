"""Images of blocks with words that a hostile peer has changed."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import strategies as st


@st.composite
def damaged_images(draw: st.DrawFn, images: Sequence[tuple[int, bytes]]) -> tuple[int, bytes]:
    """One of these images, with its target, in which up to three words have other values."""
    target, sound = draw(st.sampled_from(images))
    image = bytearray(sound)
    for _ in range(draw(st.integers(1, 3))):
        word = draw(st.integers(0, len(image) // 8 - 1))
        old = int.from_bytes(image[8 * word : 8 * word + 8], "little", signed=True)
        near = st.integers(max(-(2**63), old - 3), min(2**63 - 1, old + 3))
        new = draw(st.one_of(st.integers(-(2**63), 2**63 - 1), st.integers(0, len(image) // 8), near))
        image[8 * word : 8 * word + 8] = new.to_bytes(8, "little", signed=True)
    return target, bytes(image)
