"""Links over a network for authors of drivers: names resolved anew, and what the log says meanwhile.

`Lookup` resolves the name of an endpoint at each attempt, `Attempts` turns failures and successes into lines
for the log, and `connected` connects to the first of several addresses that answers.
"""

from lfield.driver.network.attempts import Attempts
from lfield.driver.network.lookup import Address, Lookup, connected, unbracketed

__all__ = ["Address", "Attempts", "Lookup", "connected", "unbracketed"]
