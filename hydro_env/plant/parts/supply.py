"""The supply: pump, relief valve, and accumulator or oil in the line (Figs 3 and 11)."""

from typing import Literal, NamedTuple

from pydantic import Field

from hydro_env.compiling import inline
from hydro_env.files import Group, whole_group
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE
from hydro_env.units import Number, quantity, written

SupplyModel = Literal["constant", "accumulator", "pump"]
"""Source of the supply pressure: constant; pump, relief valve and accumulator; the oil in the line instead of it."""


class Supply(Group):
    """Pump, relief valve and accumulator (``accumulator``), the same without it (``pump``), or a constant pressure.

    ``pump_flow`` 0 means that the pump does not run, ``relief_slope`` 0 that there is no relief valve.
    """

    model: SupplyModel = Field("accumulator", description="paper, Figs 3 and 11")
    pressure: Number = quantity(70e5, "Pa", "assumed; constant supply, or setting of the relief valve", 1e5, 1e8)
    tank_pressure: Number = quantity(1e5, "Pa", "assumed; back pressure of the return line", 0.0, 1e7)
    pump_flow: Number = quantity(2.15e-4, "m³/s", "derived; 9.4 cm³ × 1450 1/min × 0.95", 0.0, 1.0)
    relief_slope: Number = quantity(4e-10, "m³/(s Pa)", "assumed; of the relief valve", 0.0, 1e-4)
    line_volume: Number = quantity(0.5e-3, "m³", "assumed; oil between pump and valve (model pump)", 1e-6, 1.0)
    accumulator_volume: Number = quantity(1e-3, "m³", "paper, Table 1 (1 l)", 1e-6, 10.0)
    precharge_pressure: Number = quantity(55e5, "Pa", "assumed", 1e4, 1e8)
    polytropic_index: Number = quantity(1.3, "1", "assumed", 1.0, 1.7)

    @whole_group
    def _supply_above_tank(self) -> "Supply":
        if self.pressure <= self.tank_pressure:
            tank = written(self.tank_pressure, "Pa")
            raise ValueError(f"pressure = {written(self.pressure, 'Pa')} must be above tank_pressure = {tank}")
        if self.model != "constant" and self.relief_slope == 0.0 and self.pump_flow > 0.0:
            raise ValueError(
                f"relief_slope = 0 with pump_flow = {written(self.pump_flow, 'm³/s')}: nothing limits the pressure; "
                f"without a relief valve pump_flow must be 0 (the pump does not run) or model constant"
            )
        if self.model == "accumulator" and self.precharge_pressure >= self.pressure:
            raise ValueError(
                f"precharge_pressure = {written(self.precharge_pressure, 'Pa')} must be below pressure = "
                f"{written(self.pressure, 'Pa')}, else the accumulator stays empty"
            )
        return self

    @property
    def is_regulated(self) -> bool:
        """Whether pump and relief valve together hold the pressure."""
        return self.model != "constant" and self.pump_flow > 0.0


class SupplyCoefficients(NamedTuple):
    """Constants of the supply in the right-hand side."""

    tank_pressure: float  # P_T, Pa
    relief_pressure: float  # P_set, Pa
    relief_slope: float  # m³/(s Pa)
    pump_flow: float  # Q_pump, m³/s
    supply_dynamics: float  # n with an accumulator, 0 without
    line_stiffness: float  # β / V_line with a pump and no accumulator, Pa/m³; 0 else
    accumulator_volume: float  # V_0, m³


_, _ACCUMULATOR, _PUMP = range(3)  # numbers of the models


@inline
def supply_coefficients(p):
    """:class:`SupplyCoefficients` of the physical parameters ``p``."""
    return SupplyCoefficients(
        tank_pressure=p.supply_tank_pressure,
        relief_pressure=p.supply_pressure,
        relief_slope=p.supply_relief_slope,
        pump_flow=p.supply_pump_flow,
        supply_dynamics=p.supply_polytropic_index if p.supply_model == _ACCUMULATOR else 0.0,
        line_stiffness=p.fluid_bulk_modulus / p.supply_line_volume if p.supply_model == _PUMP else 0.0,
        accumulator_volume=p.supply_accumulator_volume,
    )


@inline
def supply_rates(s, drawn_flow, c):
    """dP_s/dt in Pa/s and dV_gas/dt in m³/s while the valve draws a flow (m³/s); both 0 with a constant supply."""
    relief = c.relief_slope * max(s.supply_pressure - c.relief_pressure, 0.0)
    surplus = c.pump_flow - drawn_flow - relief
    gas_stiffness = c.supply_dynamics * (s.supply_pressure + ATMOSPHERIC_PRESSURE) / s.gas_volume
    pressure_rate = (gas_stiffness + c.line_stiffness) * surplus
    return pressure_rate, -surplus if c.supply_dynamics > 0.0 else 0.0


@inline
def regulated_pressure(drawn_flow, c):
    """Supply pressure in Pa at which the relief valve passes the part of the pump flow that the valve does not draw.

    Without regulation it is the set value. A result below the set value means that the pump cannot feed the flow.
    """
    regulated = (c.supply_dynamics > 0.0 or c.line_stiffness > 0.0) and c.pump_flow > 0.0 and c.relief_slope > 0.0
    return c.relief_pressure + (c.pump_flow - drawn_flow) / c.relief_slope if regulated else c.relief_pressure


@inline
def gas_volume_at(supply_pressure, p):
    """Volume in m³ of the accumulator's gas, compressed from its precharge pressure (polytropic)."""
    ratio = (p.supply_precharge_pressure + ATMOSPHERIC_PRESSURE) / (supply_pressure + ATMOSPHERIC_PRESSURE)
    return p.supply_accumulator_volume * ratio ** (1.0 / p.supply_polytropic_index)
