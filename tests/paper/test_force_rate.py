"""The terms of dF/dt."""

import numpy as np
import pytest

from paper.force_rate import TERMS, force_rate_table


@pytest.fixture(scope="module", params=["laminar", "throttle"])
def table(request):
    return force_rate_table(request.param)


def test_the_terms_add_up_to_the_rate_of_the_force(table):
    """The edges of the stacked areas: what piles up above zero and what hangs below it."""
    terms = table[list(TERMS)]
    total = terms.clip(lower=0.0).sum(axis=1) + terms.clip(upper=0.0).sum(axis=1)
    assert total.to_numpy() == pytest.approx(table["sum_n_s"].to_numpy(), abs=1e-6)
    assert np.abs(total - table["from_chambers_n_s"]).max() < 1e-6 * table["from_chambers_n_s"].abs().max()


def test_every_term_is_there_and_leakage_acts_against_the_difference(table):
    assert (table[list(TERMS)].abs().max() > 0.0).all()
    against = np.sign(table["internal_leakage_n_s"]) == -np.sign(table["pressure_difference_bar"])
    assert against.all()
    assert (table["external_leakage_n_s"] >= 0.0).all()
