"""Growable arrays and maps as displayed: traces, decoded blocks, a debugger, listings."""

from __future__ import annotations

from joined_hosts import JoinedHosts

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.encoding import decode, encode
from lfield.replay.debugger.value_tree import ValueReader
from lfield.testing.golden import compile_text, run_text
from lfield.vm.agent import TeamMember
from lfield.vm.inspection.block_view import view
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.person_calls.value_conversion import EncodedValue, values_of

TEXT = """
class Place { public real north; public Place(real n) { north = n; } }
resource R {
    int[] numbers = {};
    map<string, Place> places = new map<string, Place>();
    map<int, int> none;
    init(string[] arg) {
        for (int i = 0; i < 3; i += 1) numbers.append(i * i);
        places["b"] = new Place(1);
        places["a"] = new Place(2);
        places["c"] = null;
        places.remove("b");
        while (true) yield();
    }
    portal given(map<int, string> m, int[] a) emit int {
        m[7] = "x";
        a.append(m.length());
        return a[a.length() - 1];
    }
}
"""


def running() -> tuple[Machine, Block]:
    _, machine = run_text(TEXT)
    return machine, machine.agents["r"].block


def test_a_decoded_block_shows_elements_and_entries() -> None:
    machine, block = running()
    fields = dict(view(block, machine.program).fields)
    numbers, places = fields["numbers"].partition(" @"), fields["places"].partition(" @")
    assert numbers[0] == "[3]"
    assert numbers[2].endswith("{0, 1, 4}")
    assert places[0] == "map<string, Place>[2]"
    assert '{"a": Place @' in places[2]
    assert places[2].endswith('"c": null}')
    assert fields["none"] == "null"


def test_a_debugger_expands_arrays_and_maps() -> None:
    machine, block = running()
    reader = ValueReader(block, machine.program)
    own = block.w[layout.W_SELF]
    kinds = [field.type for field in machine.program.core.classes[machine.program.class_index["R"]].fields]
    numbers, places = (reader.variable(str(i), kinds[i], block.w[own + 1 + i]) for i in range(2))
    assert (numbers.type, places.type) == ("int[]", "map<string, Place>")
    assert [(part.name, part.value) for part in reader.parts(numbers)] == [
        ("[0]", "0"),
        ("[1]", "1"),
        ("[2]", "4"),
    ]
    assert [part.name for part in reader.parts(places)] == ['["a"]', '["c"]']
    raw = places.kind, places.word
    assert reader.length((numbers.kind, numbers.word)) == 3
    assert reader.length(raw) == 2
    found = reader.part(raw, '["a"]')
    assert found is not None
    assert reader.part(found, "north") is not None
    assert reader.part(raw, "[a]") == found
    assert reader.part(raw, '["b"]') is None
    assert reader.part((numbers.kind, numbers.word), "[2]") == (
        kinds[0] and reader.part(raw, '["c"]') and 2,
        4,
    )


def test_a_mission_test_gets_lists_and_dicts() -> None:
    machine, _ = running()
    program = machine.program
    portal = next(method for method in program.core.methods if method.name == "given")
    maps, arrays = portal.slots[1:3]
    for kind, value in ((maps, {3: "a", -1: None, 2: "c"}), (maps, {}), (arrays, [5, 6]), (arrays, [])):
        block = Block.empty(program.digest, 4096)
        word = EncodedValue(program, kind, value).put(block)
        assert values_of(block, program, [kind], [word]) == [value]
        if isinstance(value, dict):
            assert list(values_of(block, program, [kind], [word])[0]) == list(value)  # type: ignore[call-overload]  # a dict


def test_a_trace_has_only_lines_of_the_program() -> None:
    text = """resource R {
    init(string[] arg) {
        map<string, int> m = new map<string, int>();
        int[] a = {1, 2};
        try { a.sort(wrong); } catch (IndexException e) { print(e.message()); }
        look(m);
    }
    private boolean wrong(int a, int b) { throw new IndexException("no"); }
    private void look(map<string, int> m) {
        print(m["x"]);
    }
}
"""
    desk, _ = run_text(text)
    (ended,) = desk.endings
    lines = [line.strip() for line in ended.report.splitlines() if line.strip().startswith("at ")]
    assert lines == ["at R.look (golden.L:10)", "at R.init (golden.L:6)"]


def test_a_program_with_arrays_and_maps_is_encoded_and_listed() -> None:
    machine, _ = running()
    program = machine.program
    assert decode(encode(program)).digest == program.digest
    listing = disassemble(program)
    assert "append, int[]" in listing
    assert "map<string, Place>.set(string, Place)" in listing


COLLECTING = """
class Found { public int[] places; public map<string, int> counts; }
resource Post {
    init(string[] arg) { while (true) yield(); }
    portal look(Found f, int n) emit Found {
        for (int i = 0; i < n; i += 1) {
            f.places.append(i);
            f.counts["place " + i2s(i % 7)] = i;
        }
        return f;
    }
}
coordinator Walker {
    init(string[] arg) {
        Post here = findPost("here");
        Post there = findPost("there");
        Found f = new Found();
        f.places = {};
        f.counts = new map<string, int>();
        int[] grown = {};
        for (int i = 0; i < 3; i += 1) {
            for (int k = 0; k < 1000; k += 1) grown.append(k);
            while (grown.length() > 10 * i + 5) grown.pop();
            f = there.look(f, 10);
            f = here.look(f, 10);
            grown.append(f.places.length());
        }
        print(i2s(f.places.length()) + " " + i2s(f.counts["place 2"]) + " " + i2s(f.counts.length()));
        print("grown " + i2s(grown.length()) + " " + i2s(grown.pop()));
    }
}
"""


def test_arrays_and_maps_migrate_without_spare_words() -> None:
    team = [
        TeamMember(0, "here", "Post", "resource", 0),
        TeamMember(1, "there", "Post", "resource", 1),
        TeamMember(2, "walker", "Walker", "coordinator", 0),
    ]
    hosts = JoinedHosts(compile_text(COLLECTING), team)
    hosts.run()
    assert sorted(hosts.printed) == ["60 9 7", "grown 26 60"]
    # A thousand elements were removed before the first hop.
    assert len(hosts.images) == 6
    assert max(map(len, hosts.images)) < 2800
