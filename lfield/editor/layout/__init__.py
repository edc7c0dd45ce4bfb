"""The layout of a text: `lfield fmt` changes only white space and line breaks."""
