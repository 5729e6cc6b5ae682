"""Files of measuring programs come in; signals in SI units, checked and cut into windows, go out.

The road: file (``files``) → ``columns`` → ``recording`` → samples (``sampling``) → checks (``quality``) → windows;
``parts`` chooses windows, and ``simulated`` writes what a simulated rig would measure.
Open ``recording.py`` first.
"""
