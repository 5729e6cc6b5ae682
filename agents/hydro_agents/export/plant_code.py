"""The plant and its integrator as one C99 source file and its header, without any library but ``math.h``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from hydro_agents.export.c_types import DOUBLE
from hydro_agents.export.translator import Translator
from hydro_env import PlantParameters, __version__
from hydro_env.plant import kernel
from hydro_env.plant.equations import (
    Coefficients,
    coefficients,
    command_changed,
    derivatives,
    derived_quantities,
    hold_limits,
    time_to_kink,
)
from hydro_env.plant.equilibrium import equilibrium_state
from hydro_env.plant.parameters import PARAMETER_PATHS, Physical, to_vector
from hydro_env.plant.states import STATE_UNITS, State

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class PlantCode:
    """Sources of the plant, as text."""

    header: str
    source: str

    def write(self, folder: Path) -> None:
        """Write ``plant.h`` and ``plant.c``."""
        (folder / "plant.h").write_text(self.header, encoding="utf-8")
        (folder / "plant.c").write_text(self.source, encoding="utf-8")


def plant_code(parameters: PlantParameters | None = None) -> PlantCode:
    """Generate the plant with the parameters of a rig as its defaults; ``None`` is the paper's.

    Raises:
        TranslationError: the plant uses a construct without translation.
    """
    translator = Translator()
    state, constants, physical = (translator.struct(kind) for kind in (State, Coefficients, Physical))
    translator.function(coefficients, [physical], "coefficients_of")
    translator.function(derivatives, [state, constants, DOUBLE])
    translator.function(command_changed, [state, constants, DOUBLE])
    translator.function(hold_limits, [state, constants])
    translator.function(time_to_kink, [state, state, constants])
    translator.function(derived_quantities, [state, constants])
    translator.function(equilibrium_state, [DOUBLE, physical, constants])
    private = [text for text in translator.structs if not text.endswith((" State;\n", " Derived;\n"))]
    values = {
        "version": __version__,
        "states": list(zip(State._fields, STATE_UNITS, strict=True)),
        "parameters": list(zip(PARAMETER_PATHS, to_vector(parameters or PlantParameters()).tolist(), strict=True)),
        "coefficients": len(Coefficients._fields),
        "coefficient_names": Coefficients._fields,
        "first_weight": Coefficients._fields.index("position_weight"),
        "shared": [text for text in translator.structs if text not in private],
        "structs": private,
        "functions": translator.functions,
        "stages": kernel.STAGES,
        "error": kernel.ERROR,
        "kernel": {
            name: getattr(kernel, name) for name in ("FIRST_STEP", "MAXIMUM_STEP", "TOLERANCE", "SHORTEST_STEP")
        },
        "most_steps": kernel.MOST_STEPS_PER_PERIOD,
    }
    return PlantCode(*(render(name, values) for name in ("plant.h.j2", "plant.c.j2")))


def render(template: str, values: Mapping[str, Any], folder: Path = TEMPLATES) -> str:
    """Text of a template of a folder; its filter ``c`` writes a number exactly, in C."""
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False)
    environment.filters["c"] = _number
    environment.filters["xml"] = lambda value: repr(min(float(value), 1e300))  # few tools can read an infinite number
    return environment.from_string((folder / template).read_text(encoding="utf-8")).render(values)


def _number(value: float) -> str:
    """A number in C, exact."""
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))
