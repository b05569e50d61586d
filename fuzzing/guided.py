"""atheris, guided by coverage, at the parsers: each in a process of its own, since libFuzzer ends its process.

    python -m fuzzing.guided TARGET COUNT SEED CORPUS

prints one JSON object a line: what came of the inputs. libFuzzer leaves an input that fails in the corpus folder.
"""

import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import stressbot_planner
from fuzzing import ROOT
from fuzzing.generated import LONGEST, Tally

LONGEST_INPUT = 4096
"""bytes"""

PATIENCE = 1800.0
"""s for one target."""


@dataclass(frozen=True)
class Target:
    """A parser of text or bytes.

    Attributes:
        name: of the interface.
        instrumented: packages whose branches guide the fuzzer.
        share: of a campaign.
        load: imports the code under test and returns the attempt on bytes, seeds and tokens; called in the fuzzer's own process.
    """

    name: str
    instrumented: tuple[str, ...]
    share: float
    load: Callable[[], tuple[Callable[[bytes], str], list[bytes], list[str]]]


def _scenario_planner() -> tuple:
    from fuzzing import files

    return _text(files.read_by_planner), [text.encode() for text in files.TEXTS], files.YAML_TOKENS


def _scenario_driver() -> tuple:
    from fuzzing import files

    return _text(files.read_by_driver), [text.encode() for text in files.TEXTS], files.YAML_TOKENS


def _plan_file() -> tuple:
    from fuzzing import files

    seeds = [json.dumps(files._plan_of(files.PRIMITIVES[:k])).encode() for k in range(1, 9)]
    return _text(files.read_plan), seeds, files.JSON_TOKENS


def _emulator() -> tuple:
    from fuzzing import instruments

    seeds = ["".join(instruments.SESSION), *instruments.SESSION]
    return instruments.told, [seed.encode("latin-1") for seed in seeds], instruments.SCPI_TOKENS


def _answers() -> tuple:
    from fuzzing import instruments

    def lie(data: bytes) -> str:
        lines = data.decode("utf-8", "replace").split("\n")
        lies = {ord(line[0]) % 64: instruments.Lie(line[1:] if line[0] != "\0" else None) for line in lines if line}
        return instruments.lied_to(lies)

    return (
        lie,
        [b"\x01Agilent Technologies,33522B,1", b'\x020,"No error"\n\x050', b"\x03+2.0E+01\n\x04-1"],
        ["nan", "+0,", "inf", "OFF"],
    )


PLANNER = ("yaml", "jsonschema", "json", "stressbot_planner")
DRIVER = ("yaml", "jsonschema", "stressbot_driver")


def compiled() -> list[str]:
    """Return the modules of the planner with functions that numba compiles: it does not take them instrumented."""
    root = Path(stressbot_planner.__file__).parent
    found = [path for path in root.rglob("*.py") if "@kernel(" in path.read_text(encoding="utf-8")]
    return [".".join(("stressbot_planner", *path.relative_to(root).with_suffix("").parts)) for path in found]


TARGETS = {
    "scenario-planner": Target("scenario file, planner", PLANNER, 0.25, _scenario_planner),
    "scenario-driver": Target("scenario file, driver and its description", DRIVER, 0.25, _scenario_driver),
    "plan-file": Target("plan file", PLANNER, 0.22, _plan_file),
    "emulator": Target("commands to the emulated instrument", DRIVER, 0.25, _emulator),
    "answers": Target("instrument answers", DRIVER, 0.03, _answers),
}


def _text(attempt: Callable[[str], str]) -> Callable[[bytes], str]:
    return lambda data: attempt(data.decode("utf-8", "replace"))


def campaign(count: int, number: int, only: str = "") -> Iterator[Tally]:
    """Give each target its share of `count` inputs; the corpus begins with good files and ends with the campaign."""
    targets = {key: target for key, target in TARGETS.items() if only in target.name}
    for key, target in targets.items() if count else ():
        tally, begin = Tally(target.name, "atheris"), time.monotonic()
        with TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "fuzzing.guided", key, str(round(count * target.share)), str(number), folder]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE, check=False)
            for line in done.stdout.splitlines():
                report = json.loads(line)
                tally.outcomes = Counter(report["outcomes"])
                tally.seconds = report["seconds"]
            if done.returncode:
                found = [
                    path.read_bytes() for path in sorted(Path(folder).glob("crash-*")) + sorted(Path(folder).glob("timeout-*"))
                ]
                tally.violations.append(f"exit code {done.returncode} at {found!r}: {done.stderr[-LONGEST:]}")
            elif not tally.inputs:
                tally.violations.append(f"nothing was tried after {time.monotonic() - begin:.0f} s: {done.stderr[-LONGEST:]}")
        yield tally


def main() -> None:
    """Be the process of one target."""
    key, count, number, folder = sys.argv[1:]
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: run make fuzz, which installs it")
    target = TARGETS[key]
    with atheris.instrument_imports(include=list(target.instrumented), exclude=compiled()):
        attempt, seeds, tokens = target.load()
    from fuzzing.interface import Interface

    interface = Interface(target.name, None, attempt)
    corpus, outcomes = Path(folder), Counter()
    for index, seed in enumerate(seeds):
        (corpus / f"seed-{index}").write_bytes(seed)
    escaped = ("".join(f"\\x{byte:02x}" for byte in token[:60].encode("utf-8", "replace")) for token in tokens)
    dictionary = corpus.with_suffix(".dict")
    dictionary.write_text("".join(f'"{token}"\n' for token in escaped))

    def try_one(data: bytes) -> None:
        outcomes[interface(data)] += 1
        if outcomes.total() == int(count):
            print(json.dumps({"outcomes": outcomes, "seconds": time.process_time()}), flush=True)

    options = [
        f"-max_len={LONGEST_INPUT}",
        f"-runs={count}",
        f"-seed={int(number) + 1}",
        f"-dict={dictionary}",
        f"-artifact_prefix={folder}/",
    ]
    atheris.Setup([sys.argv[0], *options, folder], try_one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
