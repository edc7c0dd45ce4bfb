"""Programs of several files."""

from pathlib import Path

import pytest

from lfield.errors import InputFileError, ProgramError
from lfield.lang.frontend import check_file, check_text

MAIN = 'include "parts/box.L";\nresource Arm { Box box; init(string[] arg) { box = new Box(); } }\n'


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def test_includes_are_relative_to_the_including_file(tmp_path: Path) -> None:
    box, lid = 'include "lid.L"; class Box { private Lid lid; }', 'include "../main.L"; class Lid { }'
    write(tmp_path, {"main.L": MAIN, "parts/box.L": box, "parts/lid.L": lid})
    program = check_file(tmp_path / "main.L").or_raise()
    assert [unit.name for unit in program.units] == ["Arm", "Box", "Lid"]
    assert [Path(source.name).name for source in program.sources] == ["main.L", "box.L", "lid.L"]


def test_error_is_rendered_in_its_own_file(tmp_path: Path) -> None:
    write(tmp_path, {"main.L": MAIN, "parts/box.L": "class Box { public Lid lid; }"})
    (found,) = check_file(tmp_path / "main.L").diagnostics
    assert found.span.source.name.endswith("box.L")


def test_missing_include_is_the_only_error(tmp_path: Path) -> None:
    write(tmp_path, {"main.L": MAIN})
    assert [d.code for d in check_file(tmp_path / "main.L").diagnostics] == ["L601"]


def test_library_includes_are_resolved_by_the_callback(tmp_path: Path) -> None:
    write(tmp_path, {"driver/rover.L": "class Box { }"})
    text = MAIN.replace('"parts/box.L"', "<rover/box.L>")
    requested: list[str] = []

    def find(path: str) -> Path:
        requested.append(path)
        return tmp_path / "driver" / "rover.L"

    assert check_text(text, find_include=find).program is not None
    assert requested == ["rover/box.L"]


def test_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "main.L").write_bytes(b"\xef\xbb\xbfresource Arm { init(string[] arg) { } }")
    assert check_file(tmp_path / "main.L").program is not None


def test_included_file_that_is_not_utf8_is_an_error(tmp_path: Path) -> None:
    write(tmp_path, {"main.L": MAIN, "parts/box.L": ""})
    (tmp_path / "parts/box.L").write_bytes(b"class Box {}\n\xff")
    (found,) = check_file(tmp_path / "main.L").diagnostics
    assert (found.code, found.span.line) == ("L605", 2)


@pytest.mark.parametrize("name", ["missing.L", ".", "a\0b"])
def test_unreadable_main_file_is_an_input_file_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputFileError):
        check_file(tmp_path / name)


def test_program_error_has_all_errors() -> None:
    with pytest.raises(ProgramError) as error:
        check_text("resource Arm { }").or_raise()
    assert [d.code for d in error.value.diagnostics] == ["L311"]
