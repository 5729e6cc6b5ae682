"""The command ``hydro``: one short file per command."""
