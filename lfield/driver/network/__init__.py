"""Links over a network for authors of drivers: names resolved anew, and what the log says meanwhile.

`Lookup` resolves the name of an endpoint at each attempt, `Attempts` turns failures and successes into lines
for the log, and `keep_alive` has the kernel notice within seconds that a connection's path is dead.
"""

from lfield.driver.network.attempts import Attempts
from lfield.driver.network.lookup import Address, Lookup, keep_alive, unbracketed

__all__ = ["Address", "Attempts", "Lookup", "keep_alive", "unbracketed"]
