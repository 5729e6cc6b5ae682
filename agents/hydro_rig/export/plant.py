"""The plant and its integrator as C99, without any library but ``math.h``, as FMUs for co-simulation, and in Modelica.

Inputs of the FMU: voltage of the valve, external force, leakage past the piston, faults. Outputs: states, flows and
    forces, and the readings of ideal sensors. Standard: *Functional Mock-up Interface for Model Exchange and
    Co-Simulation*, versions 2.0 and 3.0.
"""

import hashlib
import io
import math
import platform
import re
import sys
import uuid
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from hydro_env import HydroError, TaskConfig, __version__, equilibrium
from hydro_env.plant import equations, kernel
from hydro_env.plant.analysis import leak_at_test_pressure
from hydro_env.plant.equations import Coefficients, Derived
from hydro_env.plant.equilibrium import equilibrium_state, rest_of
from hydro_env.plant.parameters import (
    MODEL_CODES,
    PARAMETER_LIMITS,
    PARAMETER_PATHS,
    PARAMETER_UNITS,
    Physical,
    PlantParameters,
    to_vector,
)
from hydro_env.plant.parts.leakage import LEAK_LAWS, ROD_SEAL, leak_past_piston
from hydro_env.plant.parts.lines import VOLUMES, WAVES
from hydro_env.plant.simulate import DERIVED_UNITS
from hydro_env.plant.states import ALL_STATES, ATMOSPHERIC_PRESSURE, VAPOUR_PRESSURE, State, state_kind
from hydro_env.task.faults import fault_limits
from hydro_env.task.settings import settings_of
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE
from hydro_rig.export.c_files import c_code, compiled, render
from hydro_rig.export.expressions import DOUBLE
from hydro_rig.export.translator import Translator

MODEL = "hydro_axis"
BINARIES = {
    "linux": ("linux64", "x86_64-linux", ".so"),
    "win32": ("win64", "x86_64-windows", ".dll"),
    "darwin": ("darwin64", "x86_64-darwin", ".dylib"),
}
"""Folders of the binary in the FMUs (FMI 2.0, 3.0) and its suffix, by system."""

BASE_UNITS = {
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}), "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}), "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}), "l": (1e-3, {"m": 3}), "min": (60.0, {"s": 1}),
}  # fmt: skip
"""Factor and exponents of the SI base units; all others are base units."""

_ASCII = str.maketrans({"³": "3", "²": "2", "Ω": "Ohm", "√": "sqrt ", "·": " ", "°": "deg"})


def plant_code(parameters: PlantParameters | None = None) -> dict[str, str]:
    """C sources of the plant by file, with the parameters of a rig as its defaults; ``None`` is the paper's.

    Raises:
        TranslationError: the plant uses a construct without translation.
    """
    parameters = parameters or PlantParameters()
    structure = parameters.structure
    kind, parts = state_kind(structure), equations.parts_of(structure)
    translator = Translator()
    translate = translator.function
    base, state, constants, physical = (translator.struct(each) for each in (State, kind, Coefficients, Physical))
    translate(equations.coefficients, [physical], "coefficients_of")
    translate(equations.derivatives, [state, constants, DOUBLE, parts])
    translate(equations.command_changed, [state, constants, DOUBLE, parts])
    translate(equations.hold_limits, [state, constants, parts])
    translate(equations.time_to_kink, [state, state, constants, parts])
    translate(equations.derived_quantities, [state, constants, parts])
    translate(equations.weights, [constants, parts])
    translate(equilibrium_state, [DOUBLE, physical, constants, WAVES if structure.lines else VOLUMES])
    translate(rest_of(structure), [base, constants], "complete_at_rest")
    shared = [text for text in translator.structs if text.endswith((f" {state.element};\n", " Derived;\n"))]
    values = {
        "version": __version__,
        "axis": state.element,
        "states": [(name, ALL_STATES[name].unit) for name in kind._fields],
        "parameters": list(zip(PARAMETER_PATHS, to_vector(parameters).tolist(), strict=True)),
        "coefficients": Coefficients._fields,
        "shared": shared,
        "structs": [text for text in translator.structs if text not in shared],
        "functions": translator.functions,
        "kernel": kernel,
    }
    return c_code("plant", values)


class Variable(NamedTuple):
    """A variable of the FMU; its value reference is its index in the list."""

    name: str
    description: str
    unit: str
    causality: str
    start: float | None = None
    low: float = -math.inf
    high: float = math.inf
    items: tuple[str, ...] = ()  # of an enumeration, from 0 on

    @property
    def symbol(self) -> str:
        """Name in C."""
        return self.name.replace(".", "_").upper()


def fmu_variables(config: TaskConfig) -> list[Variable]:
    """Inputs, parameters and outputs, in the order of their value references."""
    _, voltage = equilibrium(config.plant, 0.0)
    end = 0.5 * config.plant.cylinder.stroke
    law = LEAK_LAWS[config.leakage.law]
    largest_leak = max(law.flow(limit) for limit in PARAMETER_LIMITS[f"leakage.{law.parameter}"] if limit > 0.0)
    # The piston leaks by the task's law alone.
    laws = leak_past_piston(0.0, config.leakage.law).items()
    tight = {field: none for field, none in laws if field != law.parameter}
    leak = leak_at_test_pressure(config.plant.replace(leakage=tight))
    force = PARAMETER_LIMITS["load.external_force"]
    faults = (
        ("valve_null_shift", "spool position at which the edges are centred", "1"),
        ("valve_underlap", "added to the underlap, of full stroke", "1"),
        ("valve_flow", "relative change of the rated flow", "1"),
        ("tank_pressure", "added to the tank pressure", "Pa"),
        ("external_leak", "past the rod seal, at 100 bar", "l/min"),
    )
    inputs = [
        Variable("voltage", "command to the valve's drive", "V", "input", voltage, -FULL_VOLTAGE, FULL_VOLTAGE),
        Variable("external_force", "added to the plant's own; positive against extension", "N", "input", 0.0, *force),
        Variable("leakage", "past the piston seal, at 100 bar", "l/min", "input", leak, 0.0, largest_leak),
        *(Variable(f"fault.{name}", what, unit, "input", 0.0, *fault_limits(name)) for name, what, unit in faults),
    ]
    lag = float(settings_of(config)["pressure_lag"][0]) * config.control_period
    parameters = [
        Variable("initial_position", "of the axis at rest at the start", "m", "parameter", 0.0, -end, end),
        Variable("pressure_lag", "time constant of the pressure transducers", "s", "parameter", lag, 0.0, 1.0),
        *_rig_parameters(config),
    ]
    outputs = [
        *((name, "state", ALL_STATES[name].unit) for name in state_kind(config.plant.structure)._fields),
        *((name, "follows from the state", unit) for name, unit in zip(Derived._fields, DERIVED_UNITS, strict=True)),
        ("measured_position", "ideal sensor", "m"),
        ("measured_pressure_a", "behind the transducer's lag", "Pa"),
        ("measured_pressure_b", "behind the transducer's lag", "Pa"),
        ("measured_spool_position", "ideal sensor", "1"),
        ("holding_voltage", "holds the axis at its initial position", "V"),
    ]
    variables = [*inputs, *parameters, *(Variable(name, what, unit, "output") for name, what, unit in outputs)]
    return [one._replace(unit="" if one.unit == "1" else one.unit.translate(_ASCII)) for one in variables]


def _rig_parameters(config: TaskConfig) -> Iterator[Variable]:
    """Each number of the rig but the leak, which is an input."""
    for path, value in zip(PARAMETER_PATHS, to_vector(config.plant).tolist(), strict=True):
        if path == f"leakage.{LEAK_LAWS[config.leakage.law].parameter}":
            continue
        group, field = path.replace("_", " ").split(".")
        unit, limits = PARAMETER_UNITS[path], PARAMETER_LIMITS[path]
        items = MODEL_CODES.get(path, ())
        yield Variable(f"rig.{path}", f"{field} of the {group}", unit, "parameter", value, *limits, items)


def base_unit(unit: str) -> dict[str, float]:
    """Exponents of the SI base units, and the factor, of a unit in letters; empty: one is a root, which FMI lacks."""
    found: dict[str, float] = {}
    if "sqrt" in unit:
        return found
    for side, sign in zip(unit.split("/", 1), (1, -1), strict=False):
        for name, power in re.findall(r"([A-Za-z]+)(\d?)", side):
            factor, exponents = BASE_UNITS.get(name, (1.0, {name: 1}))
            exponent = sign * int(power or 1)
            found["factor"] = found.get("factor", 1.0) * factor**exponent
            for base, own in exponents.items():
                found[base] = found.get(base, 0) + exponent * own
    return found


def _values(config: TaskConfig) -> dict[str, Any]:
    """What the templates of the FMUs and of the Modelica text say of a task."""
    return {
        "version": __version__,
        "variables": fmu_variables(config),
        "infinite": math.inf,
        "leak": LEAK_LAWS[config.leakage.law],
        "litre_per_minute": LITRE_PER_MINUTE,
    }


def modelica_text(config: TaskConfig) -> str:
    """The plant of a task as a Modelica model that starts at rest at mid-stroke; its names are those of the FMUs."""
    values = _values(config) | {
        "plant": config.plant,
        "rest": equilibrium(config.plant, 0.0)[0],
        "atmospheric_pressure": ATMOSPHERIC_PRESSURE,
        "vapour_pressure": VAPOUR_PRESSURE,
    }
    return render("hydro_axis.mo.j2", values)


def make_fmus(config: TaskConfig) -> tuple[bytes, bytes]:
    """The FMUs of a task, with its rig, in FMI 2.0 and 3.0, as the bytes of zip files; a task gives the same sources.

    Raises:
        HydroError: this machine has no C compiler or no 64-bit x86, or the compiler failed.
    """
    if sys.platform not in BINARIES or platform.machine().lower() not in ("x86_64", "amd64"):
        raise HydroError(f"the FMU has no binary for {sys.platform} on {platform.machine()}; it needs 64-bit x86")
    kind = state_kind(config.plant.structure)
    code = plant_code(config.plant)
    common = _values(config)
    named = sorted({variable.unit for variable in common["variables"]})
    values = common | {
        "model": MODEL,
        "units": render("units.xml.j2", {"units": {unit: base_unit(unit) for unit in named}}),
        "axis": kind.__name__,
        "states": kind._fields,
        "derived": Derived._fields,
        "rod_seal": ROD_SEAL,
        "guid": "",
    }
    digest = hashlib.sha256((code["plant.c"] + render("fmu.c.j2", values)).encode()).hexdigest()
    values["guid"] = "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, digest)) + "}"
    plant, core = {name: code[name] for name in ("plant.h", "plant.c")}, render("fmu.c.j2", values)
    folder, newer_folder, suffix = BINARIES[sys.platform]
    return (
        _packed(render("modelDescription.xml.j2", values), {**plant, "fmu.c": core}, f"{folder}/{MODEL}{suffix}"),
        _packed(
            render("modelDescription3.xml.j2", values),
            {**plant, "fmu.h": core, "fmi3.c": render("fmi3.c.j2", values)},
            f"{newer_folder}/{MODEL}{suffix}",
        ),
    )


def _packed(description: str, sources: Mapping[str, str], binary: str) -> bytes:
    """An FMU, with what the compiler makes of the sources."""
    files = {"modelDescription.xml": description.encode()}
    files |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    files[f"binaries/{binary}"] = compiled(sources, ["-shared", "-fvisibility=hidden", "-fPIC"])
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
