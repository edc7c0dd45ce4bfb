"""Words of other languages, and words like keywords, are ordinary names where a name may stand."""

import pytest

from lfield.lang.frontend import check_text
from lfield.lang.library import FUNCTIONS
from lfield.lang.scanner import KEYWORDS
from lfield.text import suggest

LIKE_KEYWORDS = [
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
]
HABITS = [
    *suggest.FOREIGN_TYPES,
    *suggest.FOREIGN_VALUES,
    *suggest.FOREIGN_FUNCTIONS,
    *suggest.FOREIGN_MODIFIERS,
    *suggest.FOREIGN_STATEMENTS,
    *suggest.FOREIGN_UNITS,
    "extends",
    "System",
]
WORDS = sorted({*LIKE_KEYWORDS, *HABITS} - KEYWORDS - {f.name for f in FUNCTIONS})

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
def test_as_a_field_a_method_a_portal_and_a_local(word: str) -> None:
    assert [d.render() for d in check_text(MEMBERS.replace("WORD", word)).diagnostics] == []


@pytest.mark.parametrize("word", sorted({*LIKE_KEYWORDS, *suggest.FOREIGN_TYPES, *suggest.FOREIGN_VALUES}))
def test_as_a_class(word: str) -> None:
    assert [d.render() for d in check_text(UNITS.replace("WORD", word)).diagnostics] == []
