"""The tutorial shows the files that `lfield new` writes."""

from __future__ import annotations

from pathlib import Path

from document_blocks import ROOT, blocks_of

from lfield.mission.skeleton import write_mission

PAGE = "lfield/docs/getting-started.md"


def test_tutorial_shows_the_files_of_a_new_mission(tmp_path: Path) -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    texts = {block.file: block.text for block in blocks_of(PAGE, text) if block.file}
    for path in write_mission("survey", tmp_path):
        assert path.read_text(encoding="utf-8") == texts[path.name], path.name
