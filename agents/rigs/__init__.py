"""One rig without a controller: an open-loop run, and the figures of a calculation by hand."""
