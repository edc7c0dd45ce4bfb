"""The page of `lfield watch`: the only package that imports nicegui, and only when a page is served."""

import os

# Browsers send the cookies of every program on the same address in one header, and websockets refuses header
# lines of more than 8 kB unless this says otherwise when it is imported. Browsers keep up to 180 cookies of 4 kB.
os.environ.setdefault("WEBSOCKETS_MAX_LINE_LENGTH", str(1 << 20))
