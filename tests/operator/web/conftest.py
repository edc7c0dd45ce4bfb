"""A browser for each file of tests, and pages of scripted teams."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from real_browser import Browser

SCRIPT = Path(__file__).with_name("scripted_team.py")


class Page:
    """The page of a scripted team, served by a process of its own; `do` changes the team."""

    def __init__(self, *arguments: object) -> None:
        command = [sys.executable, str(SCRIPT), *map(str, arguments)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.link = self.line()

    def line(self) -> str:
        """The next line of its output: a link, or the pressed button."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    @property
    def address(self) -> str:
        return self.link.partition("/?")[0]

    def do(self, words: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{words}\n")
        self.process.stdin.flush()

    @contextmanager
    def suspended(self) -> Iterator[None]:
        """Suspend the server within this context."""
        os.kill(self.process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self.process.pid, signal.SIGCONT)

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=60)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    made = Browser()
    yield made
    made.close()


@pytest.fixture
def page_of() -> Iterator[Callable[..., Page]]:
    pages: list[Page] = []

    def begin(*arguments: object) -> Page:
        pages.append(Page(*arguments))
        return pages[-1]

    yield begin
    for page in pages:
        page.close()


@pytest.fixture
def page(browser: Browser, page_of: Callable[..., Page]) -> Page:
    """A page that the browser has opened, and whose next link has been read."""
    opened = page_of()
    browser.open(opened.link)
    opened.line()
    return opened


@pytest.fixture(scope="module")
def _one_page() -> Iterator[Page]:
    made = Page()
    yield made
    made.close()


@pytest.fixture
def shared_page(browser: Browser, _one_page: Page) -> Page:
    """A page for all tests of a file whose changes do not affect one another; the browser opens it again."""
    browser.open(_one_page.link)
    _one_page.link = _one_page.line()
    return _one_page
