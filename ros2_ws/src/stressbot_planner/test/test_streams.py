"""However a command ends, it says so in one line and with a code of its own."""

import os
import signal
import subprocess
import sys

import pytest

PRELUDE = "import sys\nfrom stressbot_planner.system import streams\n"
PRELUDE += "from stressbot_planner.errors import ErrorCode, StressbotError\n"
PROGRAM = PRELUDE + "def command():\n    {}\n    return 3\nsys.exit(streams.run('tool', command))"


def shell(line: str, body: str, **options) -> subprocess.CompletedProcess:
    """Run a program as a shell does; `tool` in the line stands for it."""
    line = line.replace("tool", '"$PYTHON" -c "$PROGRAM"')
    environment = os.environ | {"PYTHON": sys.executable, "PROGRAM": PROGRAM.format(body)}
    return subprocess.run(["bash", "-c", line], env=environment, capture_output=True, text=True, timeout=100, **options)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("line", "body", "code", "said"),
    [
        ("tool", "print('x')", 3, ""),
        ("tool", r"raise StressbotError(ErrorCode.OUT_OF_RANGE, 'field', 'is \x1b[2J\n: no')", 2, r"tool: field: is \x1b[2J\n: no"),
        ("tool", "raise KeyboardInterrupt", 130, "tool: interrupted"),
        ("tool", "open('/nowhere/x')", 1, "/nowhere/x"),
        ("tool", "import os; os.chdir('/nowhere')", 1, "/nowhere"),
        ("tool", "raise MemoryError", 1, "out of memory"),
        ("tool", "raise ImportError('lib.so: too many open files')", 1, "lib.so"),
        ("tool", "sys.exit(2)", 2, ""),
        ("tool", "sys.exit()", 0, ""),
        ("tool", "sys.exit('no room')", 1, "tool: no room"),
        ("tool >/dev/full", "print('x')", 1, "No space left"),
        ("tool >/dev/full", "sys.exit(0)", 0, ""),
        ("PYTHONUNBUFFERED= tool >/dev/full", "print('x'); return 0", 1, "standard output cannot be written: No space left"),
        ("tool >/dev/full", "print('x' * 100_000); return 0", 1, "No space left"),
        ("tool 2>/dev/full", "raise StressbotError(ErrorCode.OUT_OF_RANGE, 'field', 'no')", 2, ""),
        ("tool >&-", "print('x'); sys.stdout.flush(); assert open('/etc/hostname').fileno() > 2", 3, ""),
        ("tool 2>&-", "raise StressbotError(ErrorCode.OUT_OF_RANGE, 'field', 'no')", 2, ""),
        ("tool <&-", "assert sys.stdin.read() == ''", 3, ""),
        ("tool <&- >&- 2>&-", "print('x'); input()", None, ""),
    ],
)
def test_one_line_and_a_code(line, body, code, said, unbuffered, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    done = shell(line, body)
    assert code is None or done.returncode == code, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == (1 if said else 0)


@pytest.mark.parametrize("body", ["print('x')", "print('x' * 1_000_000)", "print('x', flush=True)"])
def test_a_reader_that_has_seen_enough_is_no_error(body):
    # the program waits for its reader to be gone
    body = f"sys.stdin.read(); {body}"
    program = PROGRAM.format(body)
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    process.stdin.close()
    said = process.stderr.read()
    process.stderr.close()
    assert process.wait(100) in (0, 3)
    assert said == ""


def test_ctrl_c_is_one_line():
    body = "print('here', flush=True); import signal; signal.pause()"
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(body)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=100)
    assert (process.returncode, out, err) == (130, "", "tool: interrupted\n")


DELETING = """
    class Slow:
        def __del__(self):
            print('here', flush=True)
            signal.pause()
    import signal
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    Slow()
    signal.pause()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_something_is_deleted_is_not_lost(number):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(DELETING.strip())], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "here\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=100)
    assert (process.returncode, out, err) == (130, "", "tool: interrupted\n")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_what_was_printed_before_a_complaint_comes_before_it(unbuffered, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    done = shell("tool 2>&1", "print('x'); streams.complain('tool', 'y')")
    assert done.stdout == "x\ntool: y\n"
