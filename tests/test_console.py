"""Whoever writes to a terminal that is stopped, or a pipe that nobody reads, is not held up."""

import os
import re
import subprocess
import sys

import pytest

LINES = """
import os, sys
from stressbot_msgs.console import Console

count = int(sys.argv[1])
with Console():
    for k in range(count):
        (sys.stderr if k % 2 else sys.stdout).write(f"line {k} {'.' * 90}\\n")
        sys.stdout.flush()
    os.write(int(sys.argv[2]), b"written")
"""


def writing(count, done, **streams):
    return subprocess.Popen([sys.executable, "-c", LINES, str(count), str(done)], pass_fds=[done], **streams)


@pytest.fixture
def pipe():
    ends = list(os.pipe())
    yield ends
    for end in ends:
        os.close(end)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_what_is_read_comes_whole_and_in_order(pipe, count):
    out, errors = writing(count, pipe[1], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True).communicate(timeout=300)
    for text, first in ((out, 0), (errors, 1)):
        assert [int(line.split()[1]) for line in text.splitlines()] == list(range(first, count, 2))


def test_what_nobody_reads_holds_nobody_up_and_is_counted(pipe):
    """20 MB each on standard output and error."""
    process = writing(400_000, pipe[1], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert os.read(pipe[0], 7) == b"written"
    assert process.wait(300) == 0  # at the end nobody is waited for, either
    for stream in (process.stdout, process.stderr):
        assert stream.read(5) == b"line "
        stream.close()


def test_a_reader_that_comes_late_is_told_what_is_missing(pipe):
    slow = LINES.replace("    os.write", "    os.write(int(sys.argv[2]), b'go'); sys.stdin.read()\n    os.write")
    command = [sys.executable, "-c", slow, "400000", str(pipe[1])]
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, pass_fds=[pipe[1]], **streams)
    assert os.read(pipe[0], 2) == b"go"
    text = b""
    while b"left out" not in text:
        text += os.read(process.stderr.fileno(), 65536)
    (missing,) = re.findall(rb"\.\.\. (\d+) bytes that nobody read in time are left out\n", text)
    assert int(missing) > 10_000_000 and text.startswith(b"line 1 ")
    process.communicate(b"", timeout=300)
    assert process.returncode == 0


def test_nobody_at_the_other_end_is_no_error(pipe):
    process = writing(1000, pipe[1], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    process.stderr.close()
    assert process.wait(300) == 0
