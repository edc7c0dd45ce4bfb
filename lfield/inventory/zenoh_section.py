"""Reads the section `zenoh` of an inventory: the access of this team to its Zenoh fabric.

```yaml
zenoh:                                # for the desk, and for hosts without a section of their own
  connect: [tcp/192.0.2.10:7447]      # routers or peers, as Zenoh writes them
  listen: [tcp/0.0.0.0:7447]          # only from peer to peer: accept other hosts here
  multicast: true                     # find peers by multicast; default: false
  gossip: true                        # learn of peers from others; default: false
  settings: {transport/link/tls/root_ca_certificate: /etc/lfield/router-ca.pem}    # any others of Zenoh
```
"""

from __future__ import annotations

import json
import re

from lfield.net.zenoh.config import ZenohConfig
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlMapping, YamlScalar

_ENDPOINT = re.compile(r"[a-z0-9_-]+/\S+", re.ASCII)
_SETTING = re.compile(r"[a-z_]+(/[A-Za-z0-9_]+)*", re.ASCII)
_EXAMPLE = "write PROTOCOL/ADDRESS:PORT, as in tcp/192.0.2.10:7447"


def read_zenoh_section(parent: YamlFields) -> ZenohConfig | None:
    """The section `zenoh` of an inventory or of a host; None without it. Findings go to `parent`."""
    if "zenoh" not in parent:
        return None
    fields = parent.section("zenoh")
    config = ZenohConfig(
        _endpoints("connect", fields),
        _endpoints("listen", fields),
        fields.flag("multicast"),
        fields.flag("gossip"),
        _settings(fields),
    )
    if not (config.connect or config.listen or config.multicast):
        parent.report(
            "Y110", "'zenoh' needs 'connect', 'listen' or 'multicast'", parent.key_span("zenoh"), _EXAMPLE
        )
    fields.report_unread()
    return config


def _endpoints(key: str, fields: YamlFields) -> tuple[str, ...]:
    endpoints = fields.texts(key)
    for endpoint in endpoints:
        if not _ENDPOINT.fullmatch(endpoint):
            sentence = f"'{endpoint}' is not an endpoint of Zenoh"
            fields.report("Y113", sentence, fields.value_span(key), _EXAMPLE)
    return endpoints


def _settings(fields: YamlFields) -> tuple[tuple[str, str], ...]:
    """Further settings by path; each value as JSON."""
    node = fields.node("settings")
    found: dict[str, str] = {}
    for entry in node.entries.values() if isinstance(node, YamlMapping) else ():
        if not _SETTING.fullmatch(entry.key) or not isinstance(entry.value, YamlScalar):
            hint = "write the path of a setting of Zenoh, and a text, number, true or false"
            fields.report("Y113", f"'{entry.key}' is not a setting", entry.key_span, hint)
            continue
        found[entry.key] = json.dumps(entry.value.value)
    return tuple(found.items())
