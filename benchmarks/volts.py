"""From the planner's volts to the driver's, in one process."""

from stressbot_driver.bench import Bench
from stressbot_driver.sequence import VoltageSequence
from stressbot_planner.sequencing import VoltageProgram


def sequence_of(program: VoltageProgram, bench: Bench) -> VoltageSequence:
    """Return a program as the driver knows it."""
    return VoltageSequence(
        "plan", bench.swarm_id, program.levels, program.dwells, program.epoch_ends, program.duration, 0,
        program.pulses, program.low_levels, program.duty, program.alternating,
    )
