"""Controllers, leak detector, alarm and plant for other machines: C99, Structured Text, ONNX, FMU, one HTML page.

Functions of the simulation come in; files without Python go out, compared with it before they are written. Two roads:
``translator.py`` turns compiled code into C (``plant.py``); ``tracing.py`` records array code as a ``graph`` for the
writers (``controller_folder.py``). Open ``controller_folder.py`` or ``plant.py`` first.
"""
