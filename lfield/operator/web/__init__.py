"""The page of `lfield watch`: the only room that imports nicegui, and only when a page is served."""
