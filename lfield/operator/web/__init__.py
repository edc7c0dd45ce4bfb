"""The page of `lfield watch`: the only package that imports nicegui, and only when a page is served."""

import os

# Browsers send the cookies of every program on the same address in one header, up to 180 of 4 kB. websockets
# refuses header lines of more than 8 kB unless this variable says otherwise when it is imported.
os.environ.setdefault("WEBSOCKETS_MAX_LINE_LENGTH", str(1 << 20))
