"""Measure the disk space of an installation: MB of each distribution, without bytecode and of bytecode.

Makes a new environment in a temporary folder, installs palpate there with pip, and adds up the disk blocks of
all files that each distribution lists. pip and setuptools themselves are not counted. Any Python will do.

    python benchmarks/install_size.py                 # the core
    python benchmarks/install_size.py --extras sim    # with an extra
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from harness import ROOT, arguments, print_table

NOT_COUNTED = ("pip", "setuptools")
BLOCK_BYTES = 512  # unit of st_blocks
LISTING = """
import json
from importlib.metadata import distributions
named = ((each, each.metadata["Name"]) for each in distributions())
print(json.dumps({name: [str(each.locate_file(file)) for file in each.files] for each, name in named}))
"""


def disk_megabytes(paths: list[str]) -> tuple[float, float]:
    """Return the MB on disk of all files except bytecode, and of bytecode."""
    files = {Path(path).resolve() for path in paths if Path(path).exists()}
    sizes = {file: file.stat().st_blocks * BLOCK_BYTES / 1e6 for file in files}
    bytecode = sum(size for file, size in sizes.items() if file.suffix == ".pyc")
    return sum(sizes.values()) - bytecode, bytecode


def main() -> None:
    """Install, and print one line for each distribution, the largest first."""
    parser = arguments(__doc__)
    parser.add_argument("--extras", default="", help="extras to install, separated by commas")
    parser.add_argument("--least-mb", type=float, default=1.0, help="smaller distributions are added up")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        what = f"{ROOT}[{chosen.extras}]" if chosen.extras else str(ROOT)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--only-binary=:all:", what], check=True)
        listing = subprocess.run([python, "-c", LISTING], capture_output=True, check=True, cwd=folder).stdout
        named = json.loads(listing).items()
        sizes = {name: disk_megabytes(files) for name, files in named if name not in NOT_COUNTED}
    small = [name for name, size in sizes.items() if sum(size) < chosen.least_mb]
    rows = sorted(((name, *sizes[name]) for name in sizes.keys() - small), key=lambda row: -sum(row[1:]))
    for text, names in ((f"{len(small)} others", small), ("all", list(sizes))):
        rows.append((text, *(sum(sizes[name][part] for name in names) for part in (0, 1))))
    cells = [(name, *(f"{size:.1f}" for size in (*each, sum(each)))) for name, *each in rows]
    print_table(f"MB on CPython {sys.version.split()[0]}", ("", "files", "bytecode", "sum"), cells)


if __name__ == "__main__":
    main()
