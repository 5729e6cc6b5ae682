"""One rig without a controller: its file, an open-loop run, and hand calculations.

Comes in: figures from nameplates, or the file of a rig. Goes out: that file, the table of ``hydro check-rig``, a
trajectory, and gains that are stable on the rig. Open ``check.py`` first: every figure is one row of its table.
"""
