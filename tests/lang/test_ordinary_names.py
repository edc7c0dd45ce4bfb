"""Words of other languages and soft keywords are valid names where the grammar has a name."""

import pytest

from lfield.lang.frontend import check_text
from lfield.lang.language_library import FUNCTIONS
from lfield.lang.parser.foreign import foreign_words
from lfield.lang.scanner import KEYWORDS

SIMILAR_TO_KEYWORDS = [
    "Report",
    "report",
    "specific",
    "Portal",
    "port",
    "publics",
    "privat",
    "initial",
    "whilst",
    "trys",
    "together",
    "within",
    "reserve",
    "finally",
]
FOREIGN_WORDS = [
    *foreign_words.FOREIGN_TYPES,
    *foreign_words.FOREIGN_VALUES,
    *foreign_words.FOREIGN_FUNCTIONS,
    *foreign_words.FOREIGN_MODIFIERS,
    *foreign_words.FOREIGN_STATEMENTS,
    *foreign_words.FOREIGN_UNITS,
    "extends",
    "System",
]
WORDS = sorted({*SIMILAR_TO_KEYWORDS, *FOREIGN_WORDS} - KEYWORDS - {f.name for f in FUNCTIONS})

MEMBERS = """
resource Arm {
    int WORD;
    init(string[] arg) {
        WORD = 1;
        int[] list = new int[2];
        WORD(WORD);
        this.WORD = list[WORD] + this.WORD(2);
        if (WORD > 0) WORD(3); else WORD = 4;
    }
    private int WORD(int a) { return a; }
    portal WORD(string WORD) emit string { WORD = WORD + "!"; return WORD; }
}
"""
UNITS = """
resource Arm {
    WORD kept;
    init(string[] arg) { kept = new WORD(3); kept = other(kept); }
    private WORD other(WORD given) { return given; }
    private synchronized WORD[] all() { return new WORD[3]; }
    portal take(WORD given) emit WORD { kept = given; return kept; }
}
class WORD {
    private int n;
    private WORD next;
    public WORD(int a) { n = a; }
    public WORD follow() { return next; }
}
"""


@pytest.mark.parametrize("word", WORDS)
def test_word_is_a_valid_name_of_fields_methods_portals_and_locals(word: str) -> None:
    assert [d.render() for d in check_text(MEMBERS.replace("WORD", word)).diagnostics] == []


@pytest.mark.parametrize(
    "word", sorted({*SIMILAR_TO_KEYWORDS, *foreign_words.FOREIGN_TYPES, *foreign_words.FOREIGN_VALUES})
)
def test_word_is_a_valid_name_of_a_class(word: str) -> None:
    assert [d.render() for d in check_text(UNITS.replace("WORD", word)).diagnostics] == []


#: `WORD` at the start of a statement, after a `try`, and before each token that may follow a name.
STATEMENTS = """
resource Arm {
    int WORD;
    init(string[] arg) {
        WORD(5);
        WORD (5);
        WORD = 3;
        WORD += 1;
        WORD one;
        WORD[] some = {one};
        some[0] = new WORD();
        some[0].WORD(WORD);
        this.WORD(new int[] {1, 2}[0]);
        WORD(new int[] {1, 2}[0]);
        try yield(); catch (Exception e) { }
        WORD(5);
        try yield(); catch (Exception e) { }
        WORD = 3;
        try yield(); catch (Exception e) { }
        WORD two;
        {
            WORD(5);
            { }
        }
        if (WORD > 2) WORD(5); else WORD(6);
        for (WORD = 1; WORD < 3; WORD = 4) WORD(5);
        for (WORD each : some) each.WORD(1);
    }
    private void WORD(int a) { }
}
class WORD {
    public int WORD;
    public WORD() { }
    public void WORD(int a) { WORD = a; }
}
coordinator Boss {
    init(string[] arg) {
        Machine one = findMachine(arg[1]);
        one.WORD(3);
        string WORD = one.WORD("a");
        WORD = WORD + one.WORD(WORD);
    }
}
resource Machine {
    init(string[] arg) { }
    portal WORD(int a) { }
    portal WORD(string WORD) emit string { return WORD; }
}
"""


@pytest.mark.parametrize("word", ["together", "within", "reserve", "finally"])
def test_soft_keyword_without_a_block_is_a_name(word: str) -> None:
    assert [d.render() for d in check_text(STATEMENTS.replace("WORD", word)).diagnostics] == []
