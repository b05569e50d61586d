"""Settings: parameters of the driver, of its backends and of the planner, and arguments of the command line."""

from array import array
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fuzzing.instruments import SCRATCH
from fuzzing.interface import Interface, outcome
from fuzzing.orders import BENCH
from fuzzing.strategies import COUNTS, NAMES, NUMBERS
from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.driver_node import PARAMETERS
from stressbot_driver.ros.imperfections import imperfections_of
from stressbot_driver.simulation.imperfections import PREFIX, Flaws
from stressbot_driver.simulation.substrate import Substrate
from stressbot_driver.simulation.tracker import Tracker
from stressbot_planner.ros.planner_node import PARAMETERS as PLANNER_PARAMETERS

_INT64 = st.one_of(st.integers(-3, 9), st.sampled_from([2**63 - 1, -(2**63)]))

VALUES = st.one_of(
    st.none(),
    st.booleans(),
    _INT64,
    NUMBERS,
    NAMES,
    st.lists(st.booleans(), max_size=4),
    st.lists(_INT64, max_size=8).map(lambda values: array("q", values)),
    st.lists(NUMBERS, max_size=8).map(lambda values: array("d", values)),
    st.builds(lambda value, count: array("d", [value] * count), NUMBERS, COUNTS),
    st.lists(NAMES, max_size=4),
    st.binary(max_size=4).map(lambda data: [bytes([byte]) for byte in data]),
)
"""What a ROS parameter can hold, as rclpy hands it over."""

DRIVER = {declaration.name: declaration for declaration in PARAMETERS}
OPTIONS = {declaration.name: declaration for declaration in WaveformGeneratorBackend.OPTIONS}


def set_on_driver(values: dict[str, Any]) -> str:
    """As the driver takes a change of parameters: what passes the check is put to use on a substrate."""

    def set_all() -> None:
        for name, value in values.items():
            if problem := DRIVER[name].problem(value):
                raise StressbotError(ErrorCode.OUT_OF_RANGE, name, problem)
        imperfections = imperfections_of(values)
        if not imperfections.is_ideal:
            Flaws(imperfections, BENCH.ids, len(BENCH.electrical.symbol_levels))
        substrate = Substrate(BENCH, imperfections)
        substrate.apply(BENCH.electrical.drive_level)
        substrate.advance(1.0)
        if not imperfections.is_ideal:
            poses = Tracker(imperfections).measure(substrate.poses())
            assert np.isfinite(poses.x).all() and np.isfinite(poses.heading).all()

    return outcome(set_all)


def set_on_backend(values: dict[str, Any]) -> str:
    """As the driver starts with options of a backend that nobody answers for."""

    def start() -> None:
        for name, value in values.items():
            if problem := OPTIONS[name].problem(value):
                raise StressbotError(ErrorCode.OUT_OF_RANGE, name, problem)
        WaveformGeneratorBackend(BENCH, None, None, values | {"record_folder": str(SCRATCH)}, connect=_nobody)

    return outcome(start)


def _nobody() -> None:
    raise ConnectionRefusedError("nobody listens")


def set_on_planner(value: Any) -> str:
    """As the planner takes its parameter."""

    def set_it() -> None:
        if problem := PLANNER_PARAMETERS[0].problem(value):
            raise problem

    return outcome(set_it)


def _some(declared: dict, most: int) -> st.SearchStrategy[dict[str, Any]]:
    def values(names: set[str]) -> st.SearchStrategy[dict[str, Any]]:
        return st.fixed_dictionaries({name: _fitting(declared[name]) | VALUES for name in sorted(names)})

    return st.sets(st.sampled_from(sorted(declared)), min_size=1, max_size=most).flatmap(values)


def _fitting(declaration: Any) -> st.SearchStrategy:
    if isinstance(declaration.default, (bool, str, tuple)):
        return st.sampled_from([declaration.default, array("q", [1, 2]) if isinstance(declaration.default, tuple) else "any"])
    kind = st.integers if isinstance(declaration.default, int) else st.floats
    single = kind(declaration.low, declaration.high)
    return (
        single | st.lists(single, min_size=6, max_size=6).map(lambda values: array("d", values)) if declaration.listable else single
    )


_flaws = {name: declaration for name, declaration in DRIVER.items() if name.startswith(PREFIX)}

INTERFACES = (
    Interface("parameters, driver", _some(DRIVER, 3) | _some(_flaws, 4), set_on_driver, 3),
    Interface("parameters, waveform generator", _some(OPTIONS, 7), set_on_backend),
    Interface("parameters, planner", VALUES, set_on_planner, 0.5),
)
