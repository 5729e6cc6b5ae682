"""Python functions in C: what could be translated wrongly is refused."""

import pytest

from hydro_env.compiling import inline
from hydro_rig.export.expressions import DOUBLE, UINT64, TranslationError, array
from hydro_rig.export.translator import Translator


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
