"""C functions in Structured Text: they compute the same, and what could be written wrongly is refused."""

import math

import numpy as np
import pytest
from structured_text import FunctionBlock

from hydro_env.compiling import inline
from hydro_rig.export.c_to_text import TextFunctions
from hydro_rig.export.expressions import TranslationError, array
from hydro_rig.export.translator import Translator


@inline
def a_bit_of_all(x):
    for k in range(1, 9):
        if (k > 2 and x[k - 3] > 3.0) or x[k] != x[k]:
            x[0] = -(math.tanh(x[1]) ** 2) if k < 4 else k // 2
            break
        x[k], after = 2.0 * x[k], (k + 1) / 4
        x[k] = math.hypot(min(x[k], 3.0), after) + float(np.float32(0.1))


@pytest.mark.parametrize("values", [np.arange(0.3, 3.0, 0.3), np.array([1.0, -0.7, math.nan, *[0.0] * 6])])
def test_it_computes_what_python_does(values):
    translator = Translator()
    translator.function(a_bit_of_all, [array(9)])
    functions = TextFunctions("".join(translator.structs + translator.functions), {"x": 9}, "Test")
    functions.function("All", "a_bit_of_all(x)")
    head = "FUNCTION_BLOCK Test\nVAR\n    done : BOOL;\n    work : ARRAY[0..8] OF LREAL;\nEND_VAR\n"
    block = FunctionBlock(f"\n{functions.functions[0]}\n{head}    done := TestAll(work);\n")
    block.memory["work"][:] = np.nan_to_num(values, nan=1e30).tolist()
    block({})
    a_bit_of_all.py_func(values)
    np.testing.assert_allclose(block.memory["work"], np.nan_to_num(values, nan=1e30), rtol=1e-12)


@pytest.mark.parametrize(
    "statement",
    [
        *("x[0] = 1 | 2;", "p = x; p = x + 1;", "y = x[0] > 0.0;", "k = x[0];", "y = 0.0; y += 1.0;"),
        *("x[0] = unknown(x[1]);", "x[1] = x[0] + changed(x);", "while (x[0] < 1.0) { x[0] = 2.0; }"),
        *("for (k = 0; k < 3; --k) { x[k] = 0.0; }", "y = 1.0; for (turn = 0; turn < 9; ++turn) { x[0] = y; }"),
    ],
)
def test_what_could_be_written_wrongly_is_refused(statement):
    source = "static double changed(double *x) { x[0] = 1.0; return x[0]; }"
    source += f"static void f(double *x) {{ double *p; double y; long k; long turn; {statement} }}"
    with pytest.raises(TranslationError):
        TextFunctions(source, {"x": 4}, "Test").function("F", "f(x)", split="turn" if "turn" in statement else "")
