"""One rig without a controller: its file, an open-loop run, and hand calculations."""
