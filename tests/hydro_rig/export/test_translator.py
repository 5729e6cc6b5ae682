"""Python functions in C: arrays, loops and integers; what could be translated wrongly is refused."""

import pytest

from hydro_env.compiling import inline
from hydro_rig.export.expressions import DOUBLE, INT, UINT64, TranslationError, array
from hydro_rig.export.translator import Translator


@inline
def scaled(matrix, factors, row):
    row[:] = 0.0
    count = row.shape[0]
    for i in range(1, count):
        for j in range(matrix.shape[1]):
            row[i] += factors[j] * matrix[i, j]
    row[count // 2] = max(count, 2) / 2


@inline
def listing(x):
    return [x, x]


@inline
def unknown(x):
    return math_gamma(x)  # noqa: F821


@inline
def unchanged_sign(x):
    return +x


@inline
def negative_step(row):
    for i in range(3, 0, -1):
        row[i] = 0.0


@inline
def by_number(row, place):
    return row[place]


@inline
def part(row):
    return row[1:3]


def test_arrays_loops_and_integers_are_translated():
    translator = Translator()
    translator.function(scaled, [array(4, 3), array(3, constant=True), array(4)])
    text = translator.functions[0]
    assert "static void scaled(double *matrix, const double *factors, double *row)" in text
    assert "row[i] = (row[i] + (factors[j] * matrix[3 * i + j]));" in text
    assert "((double)(2 > 4 ? 2 : 4) / 2)" in text
    Translator().function(by_number, [array(4), INT])


@pytest.mark.parametrize(
    ("function", "types"),
    [
        (listing, [DOUBLE]),
        (unknown, [DOUBLE]),
        (unchanged_sign, [DOUBLE]),
        (negative_step, [array(4)]),
        (by_number, [array(4), DOUBLE]),
        (by_number, [array(4), UINT64]),
        (part, [array(4)]),
    ],
)
def test_what_could_be_translated_wrongly_is_refused(function, types):
    with pytest.raises(TranslationError, match="no translation for"):
        Translator().function(function, types)
