"""The page: one component of ours (browser/) in a page of NiceGUI, which brings Vue, Leaflet and ECharts."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

from nicegui import ui
from nicegui.element import Element

#: Leaflet as NiceGUI has it, without the element that would add a layer of the internet; and the charts.
_LEAFLET = importlib.import_module("nicegui.elements.leaflet")
importlib.import_module("nicegui.elements.echart")


class TeamPage(Element, component="browser/team.js", esm={"lfield-watch": "browser"}):
    """Everything on the page. What it shows it asks its server for (browser/server.js)."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self._props["title"] = title
        self.add_resource(Path(inspect.getfile(_LEAFLET)).parent / "dist")


def page(title: str) -> None:
    """Make the page that is served at `/`."""
    style = (Path(__file__).parent / "browser" / "style.css").read_text(encoding="utf-8")

    @ui.page("/", title=title)
    def team() -> None:
        ui.add_css(style)
        TeamPage(title)
