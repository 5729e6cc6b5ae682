"""Controllers, leakage head and plant for other machines: C99, Structured Text, ONNX, FMU; and their rehearsal.

Functions of the simulation come in; files without Python go out, compared with it before they are written. Two roads,
because Python decides in two ways: ``translator.py`` turns compiled code, with its ``if`` and loops, into C
(``plant.py``), and ``c_to_text.py`` that into Structured Text (``leakage_head.py``); ``tracing.py`` records array code,
which has none, as a ``graph`` for all writers (``controller_folder.py``). Open ``controller_folder.py`` or ``plant.py``
first.
"""
