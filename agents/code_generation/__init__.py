"""C99 code of the plant, generated from the Python functions that the fast kernel compiles."""
