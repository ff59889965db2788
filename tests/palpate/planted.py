"""A folder of somebody else's, with Python files that a program must not execute."""

import sys
from contextlib import contextmanager

NAMES = {
    *(sys.stdlib_module_names - set(sys.builtin_module_names)),
    *("sitecustomize", "usercustomize", "numpy", "palpate", "robot_io", "distributed", "zenoh", "matplotlib"),
}
REMARK = "import os; open({mark!r}, 'a').write({name!r} + chr(10)); raise ImportError('a planted file ran')"


@contextmanager
def planted_modules(folder, mark):
    """Files named like modules in a folder; each that is executed adds its name to the file `mark`."""
    for name in NAMES:
        (folder / f"{name}.py").write_text(REMARK.format(mark=str(mark), name=name))
    yield
    assert not mark.exists(), mark.read_text().split()


def install_program(folder):
    """The program as pip installs it: its own folder comes first on the path, not the current one."""
    program = folder / "bin" / "palpate"
    program.parent.mkdir()
    program.write_text("from palpate.main import main\nif __name__ == '__main__':\n    main()\n")
    return program
