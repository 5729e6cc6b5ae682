"""A recording comes in; a verdict with the size of the leak, a page and tables go out.

The road: checked samples (:mod:`hydro_rig.recordings.quality`) → ``diagnose`` (windows, readings, one way for all
commands) → ``verdict`` (rules) → pages; ``leak_test`` plans an active test and reads it. Open ``diagnose.py`` first,
then ``verdict.py``.
"""
