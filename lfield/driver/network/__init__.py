"""Network links for driver authors.

`Lookup` resolves the host name of an endpoint at each attempt, `Attempts` turns failures and successes into
log lines, and `connected` connects to the first of several addresses that answers.
"""

from lfield.driver.network.attempts import Attempts
from lfield.driver.network.lookup import Address, Lookup, connected, is_host, unbracketed

__all__ = ["Address", "Attempts", "Lookup", "connected", "is_host", "unbracketed"]
