"""The page: one own component (browser/) in a page of NiceGUI, which provides Vue, Leaflet and ECharts."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

from nicegui import ui
from nicegui.element import Element

#: NiceGUI's Leaflet without its element, which would load tiles from the internet; and the charts.
_LEAFLET = importlib.import_module("nicegui.elements.leaflet")
importlib.import_module("nicegui.elements.echart")


class TeamPage(Element, component="browser/team.js", esm={"lfield-watch": "browser"}):
    """The whole page. It requests its data from its server (browser/server.js)."""

    def __init__(self, title: str, *, is_recorded: bool) -> None:
        super().__init__()
        self._props["title"] = title
        self._props["recorded"] = is_recorded
        self.add_resource(Path(inspect.getfile(_LEAFLET)).parent / "dist")


def page(title: str, *, is_recorded: bool = False) -> None:
    """Create the page that is served at `/`; that of recordings has no buttons for orders."""
    style = (Path(__file__).parent / "browser" / "style.css").read_text(encoding="utf-8")

    @ui.page("/", title=title)
    def team() -> None:
        ui.add_css(style)
        TeamPage(title, is_recorded=is_recorded)
