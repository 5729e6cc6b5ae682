"""One rig without a controller: its file, and hand calculations.

Comes in: figures from nameplates, or the file of a rig. Goes out: that file, and the table of ``hydro
check-rig``. Open ``check.py`` first: every figure is one row of its table.
"""
