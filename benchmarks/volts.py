"""From the planner's volts to the driver's, and to simulated robots, in one process."""

from stressbot_driver.bench import Bench
from stressbot_driver.sequence import VoltageSequence
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.sequencing import VoltageProgram


def sequence_of(program: VoltageProgram, bench: Bench) -> VoltageSequence:
    """Return a program as the driver knows it."""
    return VoltageSequence(
        "plan", bench.swarm_id, program.levels, program.dwells, program.epoch_ends, program.duration, 0,
        program.pulses, program.low_levels, program.duty, program.alternating,
    )


def play(substrate: Substrate, sequence: VoltageSequence) -> None:
    """Let simulated robots see a whole sequence."""
    for index, (level, dwell) in enumerate(zip(sequence.levels.tolist(), sequence.dwells.tolist(), strict=True)):
        train = sequence.train(index)
        if train is None:
            substrate.apply(level)
            substrate.advance(dwell)
        else:
            substrate.repeat(train.pattern, train.repeats, train.duration)
