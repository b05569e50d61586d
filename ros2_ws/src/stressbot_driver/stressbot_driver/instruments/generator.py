"""A waveform generator: set up, scaled, loaded, armed, triggered and, before and after everything, switched off."""

import math
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.command_sets import recognise
from stressbot_driver.instruments.program import Capacity, Load, Scale
from stressbot_driver.instruments.recorder import Recorder
from stressbot_driver.instruments.transport import Transport

# A generator has no more digits than this [V]; limits are rounded inward to it.
RESOLUTION = 1e-3
SEQUENCE = "STRESSBOT"
# Answers may be rounded.
TOLERANCE = 1e-6
MAX_ERRORS = 30


class Generator:
    """One output of one instrument that is connected. Every failure is a StressbotError BACKEND_FAILURE that quotes it.

    `off` may be called from any thread at any time, and waits for nobody else: it has a connection of its own. The rest is called
    from one thread.
    """

    def __init__(self, connect: Callable[[], Transport], recorder: Recorder, channel: int) -> None:
        """Connect, and recognise the instrument. Raises StressbotError UNSUPPORTED as well; nothing is connected then."""
        self._connect = connect
        self._recorder = recorder
        self._switching = threading.Lock()
        self._closed = False
        self._fields = {"channel": str(channel)}
        with ExitStack() as opened:
            opened.callback(recorder.close)
            with _failures():
                self._transport = connect()
                opened.callback(self._let_go, self._transport)
                # Over which the output is switched off, and nothing else is said; None: that has failed.
                self._switch: Transport | None = connect()
                opened.callback(self._let_go, self._switch)
            self.identity = self._ask("*IDN?")
            self._commands, self._model = recognise(self.identity)
            opened.pop_all()

    # To a scaled output, switched off

    def set_up(self) -> None:
        """From any state to output off, waveforms forgotten."""
        for command in self._commands.setup:
            self._tell(command)
        self._check_errors("set-up")

    def volts_max(self) -> float:
        """[V] The generator reaches from minus to plus this, by its own word."""
        return 0.5 * self._number(self._commands.volts_max)

    def rate_max(self) -> float:
        """[samples/s] by its own word."""
        return self._number(self._commands.rate_max)

    def capacity(self) -> Capacity:
        """What it holds now, by its own word and its table."""
        commands = self._commands
        return Capacity(
            min_points=self._model.min_points,
            memory=int(self._number(commands.memory)),
            points_block=commands.points_block,
            max_entries=commands.max_entries,
            max_repeats=commands.max_repeats,
        )

    def scale(self, low: float, high: float, gain: float) -> Scale:
        """Let DAC codes span `low` to `high` [V of the generator, multiples of RESOLUTION] and nothing beyond."""
        amplitude, offset = high - low, 0.5 * (high + low)
        values = {"amplitude": amplitude, "offset": offset, "low": low, "high": high}
        self._fields = self._fields | {name: f"{value:.4f}" for name, value in values.items()}
        for command in self._commands.scale:
            self._tell(command)
        self._check_errors("scale")
        return Scale(gain, offset, amplitude, self._commands.full_scale)

    # Playing

    def load(self, load: Load) -> None:
        """Put waveforms and their sequence into the generator; the output is off meanwhile."""
        commands = self._commands
        self.off()
        self._tell(commands.clear)
        for name, codes in load.waveforms.items():
            self._tell(commands.waveform, codes.astype(commands.byte_order).tobytes(), name=name)
            self._check_errors(f"upload of waveform {name}")
        entries = []
        for block in load.blocks:
            entries.append((load.rest, 1, commands.hold))
            entries += [(e.name, e.repeats, commands.once if e.repeats == 1 else commands.repeat) for e in block.entries]
        entries.append((load.rest, 1, commands.forever))
        texts = [commands.entry.format(name=name, repeats=repeats, control=control) for name, repeats, control in entries]
        self._tell(commands.sequence, ",".join([f'"{SEQUENCE}"', *texts]).encode())
        self._check_errors("upload of the sequence")

    def arm(self, rate: float) -> None:
        """Select the sequence at `rate` [samples/s], make sure that everything is as it was told, switch the output on.

        It then waits at rest for the first trigger.
        """
        self._fields = self._fields | {"rate": f"{rate:.12g}", "name": SEQUENCE}
        for command in self._commands.select:
            self._tell(command)
        self._check_errors("selection")
        self.verify()
        self._tell(self._commands.on)
        self._check_errors("output on")

    def verify(self) -> None:
        """Ask whether all that shapes the output is still as it was told. Raises StressbotError BACKEND_FAILURE."""
        checks = self._commands.checks
        answers = self._ask(";:".join(query for query, _ in checks)).split(";")
        wanted = [expected.format(**self._fields) for _, expected in checks]
        if len(answers) != len(checks):
            raise _failure(f"{len(answers)} answers to {len(checks)} questions: call reset")
        for (query, _), answer, right in zip(checks, answers, wanted, strict=True):
            if not _same(answer, right):
                raise _failure(
                    f"{self._line(query)} answers {answer!r} instead of {right!r}: somebody else has changed it, or it did not "
                    "stick; the output is off, call reset"
                )

    def is_off(self) -> bool:
        """Ask whether the output is off, over the connection for that. May be called from any thread; is not in the record."""
        with _failures(), self._switching:
            if self._switch is None:
                raise ConnectionError("there is no connection")
            self._switch.send(self._line(self._commands.output).encode() + b"\n")
            return self._switch.receive() == self._commands.is_off

    def trigger(self) -> None:
        """Let the next block run. It has begun when this returns."""
        self._tell(self._commands.trigger)
        self._check_errors("trigger")

    # Out of harm's way

    def off(self) -> None:
        """Output off, and the instrument's word that it is; over a new connection if that for it fails.

        Raises StressbotError BACKEND_FAILURE if that fails too: the output may still be on.
        """
        with self._switching:
            if self._closed:
                return  # nothing of ours is on the output
            try:
                self._switch_off()
                return
            except Exception as cause:
                first = cause
            try:
                broken, self._switch = self._switch, None
                if broken is not None:
                    with suppress(Exception):  # a connection that is gone cannot be closed
                        broken.close()
                self._switch = self._connect()
                self._switch_off()
                self._recorder.event(f"output off failed ({first}) and succeeded over a new connection")
                return
            except Exception as cause:
                second = cause
        raise _failure(
            f"THE OUTPUT MAY BE ON: it could not be switched off ({first}; then {second}): switch it off by hand, then call reset"
        ) from second

    def close(self) -> None:
        """Let go of the connections and the record; may be called twice. Does not touch the output."""
        with self._switching:
            if self._closed:
                return
            self._closed = True
            switch, self._switch = self._switch, None
        for transport in (self._transport, switch):
            if transport is not None:
                self._let_go(transport)
        self._recorder.close()

    def _let_go(self, transport: Transport) -> None:
        try:
            transport.close()
        except Exception as cause:  # a connection that is gone cannot be closed
            self._recorder.event(f"close failed ({cause!r})")

    def _switch_off(self) -> None:
        """Sent first, and recorded afterwards."""
        commands, switch, recorder = self._commands, self._switch, self._recorder
        if switch is None:
            raise ConnectionError("there is no connection")
        said: list[Callable[[], None]] = []
        try:
            for line in (self._line(commands.off), self._line(commands.output)):
                switch.send(line.encode() + b"\n")
                said.append(partial(recorder.sent, line))
            answer = switch.receive()
            said.append(partial(recorder.received, answer))
        finally:
            for record in said:
                record()
        if answer != commands.is_off:
            raise ConnectionError(f"{self._line(commands.output)} answers {answer!r}")

    # The wire

    def _line(self, template: str, **fields: str) -> str:
        return template.format(**self._fields | fields)

    def _tell(self, template: str, block: bytes | None = None, **fields: str) -> None:
        with _failures():
            self._send(self._line(template, **fields), block)

    def _ask(self, template: str) -> str:
        with _failures():
            self._send(self._line(template))
            answer = self._transport.receive()
            self._recorder.received(answer)
            return answer

    def _number(self, template: str) -> float:
        answer = self._ask(template)
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or value <= 0.0:
            raise _failure(f"{self._line(template)} answers {answer!r}, which is no positive number: check the instrument")
        return value

    def _check_errors(self, after: str) -> None:
        """Raise what the instrument has to say after something was done, and what kept the record from being written."""
        errors = []
        while len(errors) < MAX_ERRORS:
            answer = self._ask(self._commands.error)
            if re.match(self._commands.no_error, answer):
                break
            errors.append(answer)
        if errors:
            raise _failure(f"the instrument reports after {after}: {'; '.join(errors)}: mend that, then call reset")
        self._recorder.flush()
        if self._recorder.failure is not None:
            raise _failure(
                f"{self._recorder.path} cannot be written ({self._recorder.failure}), and nothing is sent without a record: "
                "free some space, then call reset"
            )

    def _send(self, line: str, block: bytes | None = None) -> None:
        message = line.encode()
        self._recorder.sent(line, block)
        if block is not None:
            size = str(len(block)).encode()
            message += b"#%d%s" % (len(size), size) + block
        self._transport.send(message + b"\n")


@contextmanager
def _failures() -> Iterator[None]:
    try:
        yield
    except StressbotError:
        raise
    except Exception as cause:
        raise _failure(f"no word with it ({cause}): check address, cable and power, then call reset") from cause


def inward(low: float, high: float) -> tuple[float, float]:
    """Generator volts rounded to RESOLUTION, so that what is left lies inside."""
    return math.ceil(low / RESOLUTION - 1e-9) * RESOLUTION, math.floor(high / RESOLUTION + 1e-9) * RESOLUTION


def _same(answer: str, wanted: str) -> bool:
    try:
        return math.isclose(float(answer), float(wanted), rel_tol=TOLERANCE, abs_tol=1e-9)
    except ValueError:
        return answer.strip('"').upper() == wanted.upper()


def _failure(message: str) -> StressbotError:
    return StressbotError(ErrorCode.BACKEND_FAILURE, "instrument", message)
