"""The equations of the paper, the functions that compute them, and the corrections."""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd


class Equation(NamedTuple):
    """One numbered equation: what it says, the functions that compute it, and the correction made."""

    number: int
    meaning: str
    functions: tuple[str, ...]
    correction: str


_EQ = "hydro_env.plant.equations"
_PARTS = "hydro_env.plant.parts"
_AN = "hydro_env.plant.analysis"
_K_ALONE = "the printed product counts √(2/ρ) twice (flow 21 times too small); K = Q_N/√(ΔP_N/2) alone is used"
_SPLIT = "the leak is printed as a factor of dV/dt; it is a term of its own"

EQUATIONS: tuple[Equation, ...] = (
    Equation(1, "spool follows the coil current", (f"{_EQ}.derivatives",), "limits of slew and stroke added"),
    Equation(
        2,
        "flow through a valve edge",
        (f"{_PARTS}.valve.edge_flows", f"{_PARTS}.valve.smooth_root"),
        "laminar near zero drop",
    ),
    Equation(3, "valve constant from rated flow", (f"{_EQ}.coefficients",), _K_ALONE),
    Equation(4, "mass balance of a volume", (f"{_PARTS}.chambers.pressure_rate",), "–"),
    Equation(5, "the same with the density taken out", (f"{_PARTS}.chambers.pressure_rate",), "–"),
    Equation(
        6,
        "compressibility of the oil",
        (f"{_PARTS}.chambers.pressure_rate",),
        "β in Pa, printed N/m; free air may be added",
    ),
    Equation(
        7, "flow, volume and pressure of a chamber", (f"{_PARTS}.chambers.pressure_rate",), "β in Pa, printed N/m"
    ),
    Equation(8, "pressure in chamber a, no leak", (f"{_PARTS}.chambers.pressure_rate", f"{_EQ}.derivatives"), "–"),
    Equation(9, "pressure in chamber b, no leak", (f"{_PARTS}.chambers.pressure_rate", f"{_EQ}.derivatives"), "–"),
    Equation(10, "internal leakage", (f"{_PARTS}.leakage.internal_leakage",), "the rig's throttle added (root law)"),
    Equation(11, "external leakage", (f"{_PARTS}.leakage.external_leakage",), "–"),
    Equation(12, "pressure in chamber a", (f"{_EQ}.derivatives",), "–"),
    Equation(13, "pressure in chamber b", (f"{_EQ}.derivatives",), "–"),
    Equation(14, "force of the cylinder", (f"{_PARTS}.load.acceleration",), "–"),
    Equation(15, "force as an integral", ("hydro_env.plant.simulate.simulate",), "integrated with the whole state"),
    Equation(
        16,
        "the same, written out",
        (f"{_AN}.force_rate_terms",),
        "V_b0 − A_b x in every term of chamber b; external leakage with +, as in (24)",
    ),
    Equation(
        17,
        "motion of the load",
        (f"{_PARTS}.load.acceleration", f"{_PARTS}.friction.friction"),
        "friction kept, also in (18)",
    ),
    Equation(
        18,
        "the whole state space model",
        (f"{_EQ}.derivatives",),
        "pressure drop under the root, V_b0 − A_b x, both directions of the spool, friction; K alone as in (3)",
    ),
    Equation(19, "pressure in chamber a with the leak", (f"{_EQ}.derivatives",), "–"),
    Equation(20, "pressure in chamber b with both leaks", (f"{_EQ}.derivatives",), "–"),
    Equation(21, "(19) again", (f"{_EQ}.derivatives",), _SPLIT),
    Equation(22, "(20) again", (f"{_EQ}.derivatives",), f"{_SPLIT}; external leakage with −"),
    Equation(23, "rate of the force", (f"{_AN}.force_rate_terms",), "–"),
    Equation(24, "its four terms", (f"{_AN}.force_rate_terms",), "V_b0 − A_b x in every term of chamber b"),
)


def equation_table() -> pd.DataFrame:
    """Columns: equation, meaning, functions, correction."""
    rows = [(f"({e.number})", e.meaning, ", ".join(e.functions), e.correction) for e in EQUATIONS]
    return pd.DataFrame(rows, columns=["equation", "meaning", "functions", "correction"])
