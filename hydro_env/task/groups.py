"""Groups of settings with intervals: pairs of rising numbers within bounds."""

from typing import Any, Self

from pydantic import Field

from hydro_env.files import Group, whole_group
from hydro_env.units import Number

Range = tuple[Number, Number]


def interval(default: tuple[float, float], unit: str, description: str, low: float, high: float) -> Any:
    """A pair of rising numbers with its unit and its allowed range, beyond which a value must be a mistake."""
    return Field(default, description=description, json_schema_extra={"unit": unit, "low": low, "high": high})


class TaskGroup(Group):
    """A group whose intervals rise within their bounds."""

    @whole_group
    def _intervals_rise(self) -> Self:
        for name, info in type(self).model_fields.items():
            extra = info.json_schema_extra
            if isinstance(extra, dict) and "low" in extra:
                low, high = getattr(self, name)
                if not extra["low"] <= low <= high <= extra["high"]:
                    unit = "" if extra["unit"] == "1" else f" {extra['unit']}"
                    allowed = f"{extra['low']:g} to {extra['high']:g}{unit}"
                    raise ValueError(f"{name} = [{low:g}, {high:g}]: must rise within {allowed}")
        return self
