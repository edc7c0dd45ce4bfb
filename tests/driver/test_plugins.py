"""Discovery of drivers and of simulated devices, and the errors of broken ones."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from lfield.driver.plugin import Plugin, load_plugin
from lfield.driver.plugins import GROUP, Plugins, discover
from lfield.driver.sims import discover_sims
from lfield.errors import PluginError

MANIFEST = """\
driver: {name}
type: {type}
safe_states: [off]
telemetry:
  angle: {{type: real}}
"""


def entry(reference: str) -> EntryPoint:
    return EntryPoint("x", reference, GROUP)


@pytest.fixture
def plugin_at(tmp_path, monkeypatch):
    """A function that writes a plugin package and returns its reference."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(package: str, name: str, device_type: str, *, code: str = "", manifest: str = MANIFEST) -> str:
        folder = tmp_path / package
        folder.mkdir()
        monkeypatch.delitem(sys.modules, package, raising=False)
        text = f"from lfield.driver import Plugin\n{code}\n"
        text += f"PLUGIN = Plugin({name!r}, {package!r}, '{package}.none:X', 'some')\n"
        (folder / "__init__.py").write_text(text)
        (folder / "manifest.yaml").write_text(manifest.format(name=name, type=device_type))
        return f"{package}:PLUGIN"

    return make


def test_plugins_are_found_by_driver_and_by_type(plugin_at):
    plugins = discover([entry(plugin_at("plug_a", "a", "A")), entry(plugin_at("plug_b", "b", "B"))])
    assert sorted(plugins.by_driver) == ["a", "b"]
    assert sorted(plugins.device_types) == ["A", "B"]
    found = plugins.for_type("B")
    assert found is not None
    assert found.reference == "plug_b:PLUGIN"
    assert plugins.problems == []


@pytest.mark.parametrize(
    ("name", "device_type", "duplicate"), [("a", "B", "driver 'a'"), ("b", "A", "device type 'A'")]
)
def test_duplicate_driver_or_device_type_is_an_error(plugin_at, name, device_type, duplicate):
    first, second = plugin_at("dup_a", "a", "A"), plugin_at("dup_b", name, device_type)
    with pytest.raises(PluginError, match=f"dup_a:PLUGIN and dup_b:PLUGIN, both define the {duplicate}"):
        discover([entry(first), entry(second)])


def test_plugin_listed_twice_counts_once(plugin_at):
    reference = plugin_at("twice", "a", "A")
    assert list(discover([entry(reference), entry(reference)]).by_driver) == ["a"]


def test_broken_plugins_do_not_affect_the_others(plugin_at):
    references = [
        plugin_at("good", "good", "Good"),
        plugin_at("crashes", "c", "C", code="raise RuntimeError('at import')"),
        plugin_at("wrong", "w", "W", manifest="driver: [\n"),
        plugin_at("other_name", "o", "O", manifest=MANIFEST.replace("{name}", "p")),
        "not_there:PLUGIN",
        "good:Plugin",
    ]
    plugins = discover([entry(r) for r in references])
    assert list(plugins.by_driver) == ["good"]
    assert len(plugins.problems) == 5
    problems = "\n".join(plugins.problems)
    for words in (
        "at import",
        "error[Y101]",
        "has the manifest of 'p'",
        "not_there",
        "is not an lfield.driver.Plugin",
    ):
        assert words in problems


def test_missing_vendor_library_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    plugin = load_plugin("lfield_mavlink:PLUGIN")
    assert "Mavlink" in plugin.read_manifests()
    with pytest.raises(PluginError, match=r"needs pymavlink: pip install 'lfield\[mavlink\]'"):
        plugin.load()


def test_driver_that_cannot_be_imported_is_an_error():
    with pytest.raises(PluginError, match="cannot be loaded from json:Nothing"):
        Plugin("x", "json", "json:Nothing", "x").load()


def test_discovery_of_plugins_and_fakes_imports_no_vendor_library():
    code = (
        "import sys; from lfield.driver.plugins import Plugins; from lfield.driver.sims import Sims\n"
        "p = Plugins(); p.add('lfield_mavlink:PLUGIN'); s = Sims(); s.add('lfield_sim.mavlink:SIM')\n"
        "assert p.device_types and s and not p.problems and not s.problems, (p.problems, s.problems)\n"
        "assert 'pymavlink' not in sys.modules\n"
        "assert not any(m.startswith(('lfield.vm', 'lfield.lang', 'lfield.host')) for m in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_broken_fakes_are_reported_and_duplicates_refused(plugin_at):
    reference = plugin_at("nofake", "n", "N")
    sims = discover_sims([entry("lfield_sim.mavlink:SIM"), entry(reference), entry("none:SIM")])
    assert list(sims) == ["mavlink"]
    assert len(sims.problems) == 2
    with pytest.raises(PluginError, match="are both the simulated device 'mavlink'"):
        discover_sims([entry("lfield_sim.mavlink:SIM"), entry("lfield_sim.mavlink:MavlinkSim")])


def test_plugin_is_added_by_reference():
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    assert "Mavlink" in plugins.device_types


def test_third_party_driver_names_the_missing_library():
    """No extra of lfield contains the library."""
    plugin = Plugin("x", "json", "json:JSONDecoder", requires=("no_such_vendor", "json"))
    with pytest.raises(PluginError, match=r"driver 'x' needs no_such_vendor: pip install no_such_vendor$"):
        plugin.load()
