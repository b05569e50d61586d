"""What each make of waveform generator is told, as data: another make is another table.

In the templates `{channel}` is the output, `{name}` a waveform, `{rate}` samples per second, and volts are the generator's
own. Where each command of the Keysight table comes from is said in docs/instruments.md.
"""

import re
from dataclasses import dataclass

from stressbot_driver.errors import ErrorCode, StressbotError


@dataclass(frozen=True)
class Model:
    """Instruments of one make that share what cannot be asked of them."""

    pattern: str  # of the answer to `identify`
    min_points: int  # [samples] of the shortest waveform


@dataclass(frozen=True)
class CommandSet:
    """The language of one make. Its sequences play listed waveforms gap-free, can wait for a trigger, and can hold."""

    name: str
    models: tuple[Model, ...]
    full_scale: int  # DAC code that stands for the high level; its negative stands for the low one
    points_block: int  # [samples] memory is handed out in pieces of this many
    max_entries: int  # of a sequence
    max_repeats: int  # of one entry
    byte_order: str  # of DAC codes in a binary block, as numpy has it

    no_error: str  # pattern of the answer to `error` when there is none
    is_off: str  # answer to `output` when it is off

    identify: str
    error: str
    output: str
    off: str
    on: str
    trigger: str
    setup: tuple[str, ...]  # from any state to: output off, high impedance, waveforms forgotten, bus trigger
    volts_max: str  # [Vpp] largest amplitude without offset
    rate_max: str  # [samples/s]
    memory: str  # [samples] free
    scale: tuple[str, ...]  # {offset} and {amplitude} [V], [Vpp]; {low} and {high} [V] limits that the instrument guards
    clear: str  # forget all waveforms
    waveform: str  # followed by a binary block of DAC codes
    sequence: str  # followed by a binary block: the name and the entries, separated by commas
    entry: str
    once: str  # {control} of an entry that is played once,
    repeat: str  # {repeats} times,
    hold: str  # until a trigger comes,
    forever: str  # until it is told otherwise
    select: tuple[str, ...]
    checks: tuple[tuple[str, str], ...]  # queries and what they must answer whenever volts are about to come


_SOURCE = "SOUR{channel}:"

KEYSIGHT_33500 = CommandSet(
    name="Keysight 33500/33600",
    models=(
        Model(r"(Agilent|Keysight) Technologies,335\d\d[AB],", min_points=8),
        Model(r"(Agilent|Keysight) Technologies,336\d\dA,", min_points=32),
    ),
    full_scale=32767,
    points_block=128,
    max_entries=512,
    max_repeats=1_000_000,
    byte_order="<i2",
    no_error=r"[+-]?0,",
    is_off="0",
    identify="*IDN?",
    error="SYST:ERR?",
    output="OUTP{channel}?",
    off="OUTP{channel} OFF",
    on="OUTP{channel} ON",
    trigger="*TRG",
    setup=(
        "OUTP{channel} OFF",
        "*RST",
        "*CLS",
        "OUTP{channel}:LOAD INF",
        _SOURCE + "VOLT:UNIT VPP",
        _SOURCE + "DATA:VOL:CLE",
        _SOURCE + "FUNC:ARB:FILT OFF",
        "FORM:BORD SWAP",
        "TRIG{channel}:SOUR BUS",
    ),
    volts_max=_SOURCE + "VOLT? MAX",
    rate_max=_SOURCE + "FUNC:ARB:SRAT? MAX",
    memory=_SOURCE + "DATA:VOL:FREE?",
    scale=(
        _SOURCE + "VOLT:OFFS {offset}",
        _SOURCE + "VOLT {amplitude}",
        _SOURCE + "VOLT:LIM:LOW {low}",
        _SOURCE + "VOLT:LIM:HIGH {high}",
        _SOURCE + "VOLT:LIM:STAT ON",
    ),
    clear=_SOURCE + "DATA:VOL:CLE",
    waveform=_SOURCE + "DATA:ARB:DAC {name},",
    sequence=_SOURCE + "DATA:SEQ ",
    entry='"{name}",{repeats},{control},maintain,4',
    once="once",
    repeat="repeat",
    hold="repeatTilTrig",
    forever="repeatInf",
    select=(
        _SOURCE + 'FUNC:ARB "{name}"',
        _SOURCE + "FUNC ARB",
        _SOURCE + "FUNC:ARB:SRAT {rate}",
        _SOURCE + "FUNC:ARB:FILT OFF",
    ),
    checks=(
        ("FORM:BORD?", "SWAP"),
        (_SOURCE + "FUNC?", "ARB"),
        (_SOURCE + "FUNC:ARB?", "{name}"),
        (_SOURCE + "FUNC:ARB:SRAT?", "{rate}"),
        (_SOURCE + "FUNC:ARB:FILT?", "OFF"),
        (_SOURCE + "VOLT?", "{amplitude}"),
        (_SOURCE + "VOLT:OFFS?", "{offset}"),
        (_SOURCE + "VOLT:UNIT?", "VPP"),
        (_SOURCE + "VOLT:LIM:LOW?", "{low}"),
        (_SOURCE + "VOLT:LIM:HIGH?", "{high}"),
        (_SOURCE + "VOLT:LIM:STAT?", "1"),
        ("OUTP{channel}:LOAD?", "9.9E+37"),
        ("TRIG{channel}:SOUR?", "BUS"),
    ),
)

COMMAND_SETS = (KEYSIGHT_33500,)


def recognise(identity: str) -> tuple[CommandSet, Model]:
    """The table for an instrument by its answer to *IDN?. Raises StressbotError UNSUPPORTED, naming the known ones."""
    for commands in COMMAND_SETS:
        for model in commands.models:
            if re.match(model.pattern, identity):
                return commands, model
    known = ", ".join(commands.name for commands in COMMAND_SETS)
    raise StressbotError(
        ErrorCode.UNSUPPORTED,
        "visa_resource",
        f"there is no command set for {identity!r} (only for {known}): use one of those or add a table, see docs/instruments.md",
    )
