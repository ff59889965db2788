"""What C code prints is captured in memory, and nothing is opened for writing."""

import subprocess
import sys

# In a process of its own: an audit hook stays for good.
PROGRAM = """
import os, sys
from robot_io.captured import STDERR, STDOUT, captured

opened = []
def note(event, arguments):
    if event == "open" and isinstance(arguments[0], str | bytes) and arguments[2] & (os.O_WRONLY | os.O_RDWR):
        opened.append(arguments[0])

sys.addaudithook(note)
lines = []
with captured(lines, STDOUT, STDERR):
    os.write(STDOUT, b"first\\n")
    os.write(STDERR, b"second\\n")
print(lines, opened)
"""


def test_what_is_printed_is_captured_without_a_file_that_is_open_for_writing():
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "['first', 'second'] []\n"
    assert done.stderr == ""
