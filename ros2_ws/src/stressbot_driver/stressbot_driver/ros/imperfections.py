"""The simulated substrate's imperfections as parameters of the driver, all named `imperfections.…`."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from stressbot_driver.declaration import Declaration
from stressbot_driver.simulation.imperfections import PREFIX, Imperfections


def _declaration(name: str, default: Any, limits: Mapping[str, Any]) -> Declaration:
    return Declaration(
        PREFIX + name,
        default,
        f"{limits['description']} Simulated backend only; fixed while a sequence runs.",
        low=limits.get("low", 0.0),
        high=limits.get("high", math.inf),
        listable=limits.get("per_robot", False),
    )


PARAMETERS = tuple(_declaration(entry.name, entry.default, entry.metadata) for entry in fields(Imperfections))


def imperfections_of(values: Mapping[str, Any]) -> Imperfections:
    """The settings from parameter values by full name; others are left alone. Raises StressbotError."""
    given = {name.removeprefix(PREFIX): value for name, value in values.items() if name.startswith(PREFIX)}
    return Imperfections(**given)
