"""One rig without any controller: an open-loop run, and the figures that an engineer works out by hand."""
